//! Of what `pixel/descent` keeps to itself.

use super::*;

#[test]
fn what_nothing_depends_on_stays_where_it_is() {
    let mut point = Point::<3, UNKNOWNS> {
        materials: Materials {
            albedo: [Plane([0.5; BLOCK]); 3],
            roughness: Plane([0.5; BLOCK]),
            metallic: Plane([0.5; BLOCK]),
        },
        ..Point::default()
    };
    point.sums.matrix[0][0] = Plane([4.0; BLOCK]);
    point.sums.gradient[0] = Plane([1.0; BLOCK]);
    let (mut trial, mut predicted) = (Materials::default(), Doubles::default());
    Instructions::best().run(Step {
        point: &point,
        metallic_known: false,
        damping: &Doubles::default(),
        active: &Plane([1.0; BLOCK]),
        trial: &mut trial,
        offsets: &mut TangentOffsets::default(),
        predicted: &mut predicted,
    });
    let found: Vec<f64> = trial.planes().map(|plane| plane.0[7]).collect();
    assert_eq!(found, [0.25, 0.5, 0.5, 0.5, 0.5]);
    assert_eq!(predicted.0[7], 0.25);
}
