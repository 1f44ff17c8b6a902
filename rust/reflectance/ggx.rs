//! The GGX lobe: zonal band weights, Smith masking and Schlick Fresnel, each beside its derivative.
//!
//! Everything is float64: float32 loses the band weights of near-mirror and near-rough surfaces.

use std::f64::consts::LN_2;

/// Cosines below this are raised to it in masking and Fresnel (never in the mirror direction).
pub const MIN_COSINE: f64 = 1e-4;

/// Reflectance of a dielectric at normal incidence.
pub const DIELECTRIC_F0: f64 = 0.04;

/// Zonal weights of the GGX distribution, bands 0 to 3, and their derivative by roughness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bands {
    /// h_l(r)
    pub weight: [f64; 4],
    /// dh_l/dr
    pub slope: [f64; 4],
}

/// Band weights h_l(r) of the paper's eqs. 8-11 for perceptual roughness r in \[0, 1\].
///
/// With e = α² = r⁴ and t = (1−e)/(1+e), the projection of D onto the Legendre polynomials is
///
/// ```text
/// h_l = 8e ∫₀¹ P_l(u) / (1+e−(1−e)u)² du = 2(1−t²) ∫₀¹ P_l(u) / (1−tu)² du.
/// ```
///
/// Write q = 1−t = 2e/(1+e) and M_j for the same integral with uʲ in place of P_l. Substituting
/// s = 1−tu gives M_j = 2(2−q) B_j / tʲ⁺¹ with
///
/// ```text
/// B₀ = t                       B₂ = t + 2 q ln q + q t
/// B₁ = t + q ln q              B₃ = t + 3 q ln q + 3 q t − q (1−q²)/2
/// h₀ = M₀ = 2(2−q),  h₁ = M₁,  h₂ = (3 M₂ − M₀)/2,  h₃ = (5 M₃ − 3 M₁)/2.
/// ```
///
/// The B_j cancel as t → 0, that is r → 1; a Taylor series about r = 1 switched on at 1−e < 10⁻³
/// (the paper's rule) comes too late and leaves 10⁻² in h₃. So the closed form serves r < 0.4
/// only, where t > 0.95, and Chebyshev series in r serve [0.4, 1]. Both sides meet within 10⁻¹⁴.
#[inline]
pub fn bands(r: f64) -> Bands {
    if r < SERIES_FROM {
        closed_form(r)
    } else {
        series(r)
    }
}

fn closed_form(r: f64) -> Bands {
    let r3 = r * r * r;
    let e = r3 * r;
    let q = 2.0 * e / (1.0 + e);
    let dq = 8.0 * r3 / ((1.0 + e) * (1.0 + e));
    let t = 1.0 - q;
    // ln q from ln r: e underflows long before r does. At r = 0 the limits of q ln q and of its
    // derivative (ln q + 1) dq/dr are 0.
    let (q_ln_q, d_q_ln_q) = if r > 0.0 {
        let ln_q = LN_2 + 4.0 * r.ln() - e.ln_1p();
        (q * ln_q, (ln_q + 1.0) * dq)
    } else {
        (0.0, 0.0)
    };
    let b = [
        t,
        t + q_ln_q,
        t + 2.0 * q_ln_q + q * t,
        t + 3.0 * q_ln_q + 3.0 * q * t - 0.5 * q * (1.0 - q * q),
    ];
    let db = [
        -dq,
        -dq + d_q_ln_q,
        -dq + 2.0 * d_q_ln_q + (1.0 - 2.0 * q) * dq,
        -dq + 3.0 * d_q_ln_q + 3.0 * (1.0 - 2.0 * q) * dq - 0.5 * (1.0 - 3.0 * q * q) * dq,
    ];
    let mut moment = [0.0; 4];
    let mut slope = [0.0; 4];
    let scale = 2.0 * (2.0 - q);
    let mut power = t; // tʲ⁺¹
    for j in 0..4 {
        let m = scale * b[j] / power;
        moment[j] = m;
        // d(scale B t^-(j+1)) with d scale = −2 dq and dt = −dq
        slope[j] = (scale * db[j] - 2.0 * dq * b[j]) / power + (j + 1) as f64 * m * dq / t;
        power *= t;
    }
    Bands {
        weight: legendre_from_moments(moment),
        slope: legendre_from_moments(slope),
    }
}

fn legendre_from_moments(m: [f64; 4]) -> [f64; 4] {
    [m[0], m[1], 1.5 * m[2] - 0.5 * m[0], 2.5 * m[3] - 1.5 * m[1]]
}

/// h₀ = 4/(1 + r⁴) and its derivative; the other bands are 0, or those of the closed form.
#[inline(always)]
pub fn band_0(r: f64) -> Bands {
    if r < SERIES_FROM {
        return closed_form(r);
    }
    let r3 = r * r * r;
    let e1 = 1.0 + r3 * r;
    Bands {
        weight: [4.0 / e1, 0.0, 0.0, 0.0],
        slope: [-16.0 * r3 / (e1 * e1), 0.0, 0.0, 0.0],
    }
}

fn series(r: f64) -> Bands {
    let s = (2.0 * r - (SERIES_FROM + 1.0)) / (1.0 - SERIES_FROM);
    let mut bands = band_0(r);
    bands.weight[1..].copy_from_slice(&clenshaw(&BAND, s));
    bands.slope[1..].copy_from_slice(&clenshaw(&BAND_SLOPE, s));
    bands
}

/// Σ c_j T_j(s) for three series at once: three independent chains keep the processor busy.
fn clenshaw(c: &[[f64; 3]; TERMS], s: f64) -> [f64; 3] {
    let mut b1 = [0.0; 3];
    let mut b2 = [0.0; 3];
    for j in (1..TERMS).rev() {
        for l in 0..3 {
            let b0 = c[j][l] + 2.0 * s * b1[l] - b2[l];
            b2[l] = b1[l];
            b1[l] = b0;
        }
    }
    [0, 1, 2].map(|l| c[0][l] + s * b1[l] - b2[l])
}

/// Smith masking G₁(x) = x / (x(1−k)+k) with k = α²/2 = r⁴/2 (as printed in the paper, §9.1),
/// and dG₁/dr = −x(1−x)/(x(1−k)+k)² · 2r³.
#[inline(always)]
pub fn smith_g1(x: f64, r: f64) -> (f64, f64) {
    let r3 = r * r * r;
    let k = 0.5 * r3 * r;
    let inverse = 1.0 / (x * (1.0 - k) + k);
    (x * inverse, -x * (1.0 - x) * inverse * inverse * 2.0 * r3)
}

/// dG₁/dx = k/(x(1−k)+k)². As x is raised to [`MIN_COSINE`], G₁ does not change with the normal
/// where n·v ≤ [`MIN_COSINE`]: there callers take 0 instead.
#[inline(always)]
pub fn smith_g1_by_cosine(x: f64, r: f64) -> f64 {
    let r2 = r * r;
    let k = 0.5 * r2 * r2;
    let inverse = 1.0 / (x * (1.0 - k) + k);
    k * inverse * inverse
}

/// Schlick's (1−x)⁵, so that F = F0 + (1−F0)(1−x)⁵ and dF/dF0 = 1 − (1−x)⁵.
#[inline(always)]
pub fn schlick(x: f64) -> f64 {
    let y = 1.0 - x;
    let y2 = y * y;
    y2 * y2 * y
}

/// Its slope −5(1−x)⁴. Like [`smith_g1_by_cosine`] it is for n·v > [`MIN_COSINE`] only.
#[inline(always)]
pub fn schlick_by_cosine(x: f64) -> f64 {
    let y = 1.0 - x;
    let y2 = y * y;
    -5.0 * y2 * y2
}

/// Roughness from which the series is used, and below which the closed form: both meet within 1e-14.
const SERIES_FROM: f64 = 0.4;
/// Terms of a series; `tools/ggx_chebyshev.py` makes them.
const TERMS: usize = 25;

// Written by tools/ggx_chebyshev.py; the rounded series are exact to 6e-16.
#[rustfmt::skip]
const BAND: [[f64; 3]; TERMS] = [
    [2.1753157587500005, 1.1283539422799107, 0.583849128280164],
    [-1.265948752110249, -1.4291725953376462, -1.2043684717745675],
    [0.06039990648313886, 0.2970177378250301, 0.4167646641549194],
    [0.03711510121918508, 0.02055954255905116, -0.033627620792827426],
    [-0.006678229093798077, -0.01922758303737395, -0.017993479938863317],
    [-0.00043477990915164334, 0.002151399740041997, 0.005859961097163044],
    [0.0002494650759505052, 0.0004421790694142444, -0.00034466947784699985],
    [-1.5132892449545552e-05, -0.00012974089201560522, -0.0001834997683949189],
    [-3.8095930076247576e-06, 2.919894399885239e-06, 4.685015702167006e-05],
    [4.294197126415472e-07, 2.3829868360386827e-06, -2.026805139084208e-06],
    [4.4158103440318484e-08, -1.6885808904076936e-07, -1.0350844315529012e-06],
    [9.507840081590398e-10, -1.0626549293114077e-08, 2.1009469766667252e-07],
    [-2.3957669590765538e-09, -6.706325927003188e-09, -7.712633945656596e-09],
    [-1.8114758365397995e-10, 6.675363877393404e-10, -2.9731436292516912e-09],
    [1.1857528871331035e-10, 5.181149217452126e-10, 6.02749935562245e-10],
    [4.624752501974973e-12, -6.597051180968349e-11, -5.955587064733613e-11],
    [-4.564725038571286e-12, -2.012398215115484e-11, -1.4401811676994054e-12],
    [-9.600369570357923e-14, 3.177182485568274e-12, 2.6079452855681024e-12],
    [1.5757796895470888e-13, 7.239213366319004e-13, -4.762177956622049e-13],
    [4.270106485156341e-15, -1.1784188935568465e-13, -1.7655183518841043e-14],
    [-5.717639414004931e-15, -2.9744226199127947e-14, 1.5639831903940413e-14],
    [-1.9875696672076993e-16, 4.4281121283618835e-15, -6.034235612883327e-16],
    [2.1352945366771144e-16, 1.279280832224802e-15, -3.373367925464802e-16],
    [8.83876010989537e-18, -1.7487780806887205e-16, 8.601619412649116e-18],
    [-8.454716418901292e-18, -5.686125693133572e-17, 9.987120796323613e-18],
];
#[rustfmt::skip]
const BAND_SLOPE: [[f64; 3]; TERMS] = [
    [-3.856264684322211, -4.525412724915441, -4.257506655835982],
    [0.6370241648286888, 3.465332099730235, 5.06567838636496],
    [0.727128978757239, 0.476991852420093, -0.48589016650817995],
    [-0.16830792161316252, -0.4949044046035001, -0.49118380236729936],
    [-0.015173045626462545, 0.06580100123906982, 0.18666224934836853],
    [0.009778187554786193, 0.0178311430598053, -0.011357670664277614],
    [-0.0006803819880744324, -0.00591232342899674, -0.00866978722373292],
    [-0.00020041548323401437, 0.00014398028323552638, 0.0024291084496023793],
    [2.5819659571026696e-05, 0.00014225153173150456, -0.00010646469863670402],
    [2.762810505972713e-06, -1.1747418091686371e-05, -6.95665915533572e-05],
    [5.447681253386203e-08, -7.276784308163814e-07, 1.514360970834848e-05],
    [-1.810630567151859e-07, -4.902121556350808e-07, -5.609627831637967e-07],
    [-1.5247348064467568e-08, 5.160185067865088e-08, -2.633347872075048e-07],
    [1.0598300010938404e-08, 4.629391852517431e-08, 5.6047932488731014e-08],
    [4.5210918554402815e-10, -6.251302925425301e-09, -5.662339339024907e-09],
    [-4.687269356372188e-10, -2.063474171045435e-09, -2.0872816374520714e-10],
    [-1.0366064653483902e-11, 3.4574825554328696e-10, 2.932477257087265e-10],
    [1.8177068476826315e-11, 8.308392507541635e-11, -5.5108839190263754e-11],
    [5.143541932763373e-13, -1.4332426160460591e-11, -2.3194066561455882e-12],
    [-7.322877919001992e-13, -3.786635264603075e-12, 2.037296280405143e-12],
    [-2.6525970136455927e-14, 5.942133086389151e-13, -8.308339932768526e-14],
    [3.0063978890954536e-14, 1.7926022895974726e-13, -4.801440488606917e-14],
    [1.3002113009424198e-15, -2.572617858466008e-14, 1.3955883826301032e-15],
    [-1.249727872079398e-15, -8.335732151547932e-15, 1.4556484730289827e-15],
    [-6.00890067573106e-17, 1.1832398548757044e-15, 8.537912920701093e-17],
];
