//! Of what `pixel/pixel_fit` keeps to itself.

use super::*;
use crate::reflectance::planes::Plane;

#[test]
fn local_minima_come_from_the_lowest_and_equals_count_once() {
    let values = [
        [3.0, 2.0, 2.0, 9.0],
        [3.0, 5.0, 5.0, 9.0],
        [9.0, 9.0, 9.0, 9.0],
        [1.0, 9.0, 9.0, 4.0],
    ];
    let nodes: Vec<Doubles> = values
        .as_flattened()
        .iter()
        .map(|&v| Plane([v; BLOCK]))
        .collect();
    let found = [0, 1, 2, 3, 4].map(|rank| local_minimum(&nodes, 4, 3, rank));
    assert_eq!(found, [Some(12), Some(1), Some(15), None, None]);
    assert_eq!(local_minimum(&nodes[..12], 4, 3, 0), Some(1));
}
