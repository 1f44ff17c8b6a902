//! The mirror-like reflection of both models as sums of round lobes: `tools/environment_lobes.py`.
//!
//! With x = n·v, the mirror direction at the angle φ_m = acos x from the normal, and the lobes K of
//! [`super::blurred`],
//!
//! ```text
//! D V n·l (1 − (1−v·h)⁵) ≈ Σ_k a_k K(l·d_k; λ_k)     D V n·l (1−v·h)⁵ ≈ Σ_k b_k K(l·d_k; λ_k)
//! ```
//!
//! where d_k lies in the plane of incidence, φ_m + φ_k from the normal. The last two lobes are the
//! hemispheres of [`super::blurred`], which the horizon cuts. All of a_k and b_k are 0 or more.

use std::sync::LazyLock;

use crate::reflectance::model::Model;

/// Lobes of a surface, with two hemispheres at the end.
pub const LOBES: usize = 8;
/// Steps of the table by roughness, and by the root of n·v.
pub const CELLS: [usize; 2] = [20, 20];

const MODELS: usize = 2;
const HEADER: usize = 24;
const NODES: usize = (CELLS[0] + 1) * (CELLS[1] + 1);
const NUMBERS: usize = MODELS * NODES * LOBES * 4;

static FILE: &[u8; HEADER + 4 * NUMBERS] = include_bytes!("environment_lobes.bin");

/// One round lobe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lobe {
    /// Its angle from the normal less the mirror direction's, radians.
    pub angle: f64,
    /// log₂ of its width in σ_0.
    pub level: f64,
    /// a_k
    pub base: f64,
    /// b_k
    pub grazing: f64,
}

static TABLE: LazyLock<Vec<[f32; 4 * LOBES]>> = LazyLock::new(|| {
    let (numbers, _) = FILE[HEADER..].as_chunks::<4>();
    let numbers: Vec<f32> = numbers
        .iter()
        .map(|&bytes| f32::from_le_bytes(bytes))
        .collect();
    numbers.as_chunks().0.to_vec()
});

/// Makes the table, if nobody has yet.
pub fn prepare() {
    LazyLock::force(&TABLE);
}

/// [φ_k, λ_k, a_k, b_k] of all lobes at all nodes of a model: (roughness, n·v, lobe, 4).
pub fn nodes(model: Model) -> &'static [[f32; 4 * LOBES]] {
    let model = match model {
        Model::Paper => 0,
        Model::Principled => 1,
    };
    &TABLE[model * NODES..][..NODES]
}

/// The lobes of a surface, linear between nodes.
#[inline]
pub fn lobes(model: Model, roughness: f64, n_dot_v: f64) -> [Lobe; LOBES] {
    let nodes = nodes(model);
    let place = |x: f64, cells: usize| {
        let along = x.clamp(0.0, 1.0) * cells as f64;
        let cell = (along as usize).min(cells - 1);
        (cell, along - cell as f64)
    };
    let (row, lower) = place(roughness, CELLS[0]);
    let (column, right) = place(n_dot_v.max(0.0).sqrt(), CELLS[1]);
    let first = row * (CELLS[1] + 1) + column;
    let corners = [
        (&nodes[first], (1.0 - lower) * (1.0 - right)),
        (&nodes[first + 1], (1.0 - lower) * right),
        (&nodes[first + CELLS[1] + 1], lower * (1.0 - right)),
        (&nodes[first + CELLS[1] + 2], lower * right),
    ];
    std::array::from_fn(|k| {
        let number = |i: usize| {
            let weighted = corners.map(|(node, weight)| weight * f64::from(node[4 * k + i]));
            (weighted[0] + weighted[1]) + (weighted[2] + weighted[3])
        };
        Lobe {
            angle: number(0),
            level: number(1),
            base: number(2),
            grazing: number(3),
        }
    })
}
