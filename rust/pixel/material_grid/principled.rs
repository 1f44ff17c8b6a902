//! The best albedo from products with the principled model.
//!
//! ```text
//! I_i = kd D_i + A U_i + B V_i         U_i = Σ_j a_j B_ji         V_i = Σ_j b_j B_ji
//! ```
//!
//! With the factors f = (kd, A, B)(ρ) and G, t the products of D, U and V with each other and with
//! T, χ² = fᵀGf − 2f·t + TᵀT. The factors are nearly linear in ρ, so Newton's method may take 2
//! f'ᵀGf' for its second derivative, which is never negative.

use crate::pixel::material_grid::{AlbedoFromProducts, ByAlbedo, Given, STARTS};
use crate::reflectance::planes::{BLOCK, Doubles, Plane};
use crate::reflectance::principled::{Mix, Mixer, Principled, ROWS, Surface};
use crate::reflectance::sh::Real;
use crate::runtime::simd::Isa;

/// What remains when roughness is given.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtRoughness {
    /// a₀, b₀, Ē and κ.
    a: Doubles,
    b: Doubles,
    mean: Doubles,
    glass: Doubles,
    form: Quadratic<Doubles>,
    /// By which float32 can hold the form.
    scale: Doubles,
}

/// Products DD, DU, DV, UU, UV, VV, DT, UT and VT.
#[derive(Clone, Copy, Debug, Default)]
struct Quadratic<T>([T; 9]);

impl Quadratic<Doubles> {
    #[inline(always)]
    fn at<T: Real>(&self, x: usize, scale: f64) -> Quadratic<T> {
        let mut at = [T::default(); 9];
        for i in 0..9 {
            at[i] = T::from_f64(self.0[i].0[x] * scale);
        }
        Quadratic(at)
    }
}

impl<T: Real> Quadratic<T> {
    /// Gf
    #[inline(always)]
    fn through(&self, f: &Mix<T>) -> Mix<T> {
        let [dd, du, dv, uu, uv, vv, ..] = self.0;
        Mix {
            diffuse: dd * f.diffuse + du * f.a + dv * f.b,
            a: du * f.diffuse + uu * f.a + uv * f.b,
            b: dv * f.diffuse + uv * f.a + vv * f.b,
        }
    }

    /// f·t
    #[inline(always)]
    fn target(&self, f: &Mix<T>) -> T {
        let [.., dt, ut, vt] = self.0;
        dt * f.diffuse + ut * f.a + vt * f.b
    }

    /// χ² − TᵀT
    #[inline(always)]
    fn value(&self, f: &Mix<T>) -> T {
        dot(f, &self.through(f)) - T::from_f64(2.0) * self.target(f)
    }

    /// Half of slope and bend in the direction `by` from f.
    #[inline(always)]
    fn slope_and_bend(&self, f: &Mix<T>, by: &Mix<T>) -> (T, T) {
        let bent = self.through(by);
        (dot(&bent, f) - self.target(by), dot(by, &bent))
    }
}

#[inline(always)]
fn dot<T: Real>(f: &Mix<T>, g: &Mix<T>) -> T {
    f.diffuse * g.diffuse + f.a * g.a + f.b * g.b
}

impl<const S: bool> AlbedoFromProducts for Principled<S> {
    type AtRoughness = AtRoughness;

    /// From the products of rows to those of U and V.
    #[inline(always)]
    fn set_channel(given: Given<'_, Self>, at: &mut AtRoughness) {
        let (products, functions) = (given.products, given.functions);
        let (a, b) = (&functions[..ROWS], &functions[ROWS..2 * ROWS]);
        let zero = Doubles::default();
        let (mut du, mut dv, mut ut, mut vt) = (zero, zero, zero, zero);
        let (mut uu, mut uv, mut vv) = (zero, zero, zero);
        for i in 0..ROWS {
            // Row i of the products, times a and b.
            let (mut by_a, mut by_b) = (zero, zero);
            for j in 0..ROWS {
                let product = products.of(1 + i, 1 + j);
                for x in 0..BLOCK {
                    by_a.0[x] += product.0[x] * a[j].0[x];
                    by_b.0[x] += product.0[x] * b[j].0[x];
                }
            }
            let (diffuse, target) = (products.of(0, 1 + i), products.with_target(1 + i));
            for x in 0..BLOCK {
                uu.0[x] += a[i].0[x] * by_a.0[x];
                uv.0[x] += a[i].0[x] * by_b.0[x];
                vv.0[x] += b[i].0[x] * by_b.0[x];
                du.0[x] += a[i].0[x] * diffuse.0[x];
                dv.0[x] += b[i].0[x] * diffuse.0[x];
                ut.0[x] += a[i].0[x] * target.0[x];
                vt.0[x] += b[i].0[x] * target.0[x];
            }
        }
        let (dd, dt, tt) = (
            *products.of(0, 0),
            *products.with_target(0),
            products.target_target(),
        );
        for x in 0..BLOCK {
            let sizes = dd.0[x] + uu.0[x] + vv.0[x] + tt.0[x];
            at.scale.0[x] = 1.0 / (sizes + f64::MIN_POSITIVE);
        }
        at.form = Quadratic([dd, du, dv, uu, uv, vv, dt, ut, vt]);
        (at.a, at.b) = (functions[0], functions[ROWS]);
        (at.mean, at.glass) = (functions[2 * ROWS], functions[2 * ROWS + 1]);
    }

    #[inline(always)]
    fn minimize<I: Isa, const STEPS: usize, const EXACT: usize>(
        by_albedo: ByAlbedo<'_, AtRoughness>,
    ) {
        let ByAlbedo {
            products,
            at_roughness,
            metallic,
            albedo,
            sum_sq_residuals,
        } = by_albedo;
        for ((products, at), albedo) in products.iter().zip(at_roughness).zip(albedo) {
            let mut found = [Plane::<f32>::default(); 2];
            search::<STEPS>(at, metallic, &mut found);
            let of_tt = products.target_target();
            for x in 0..BLOCK {
                let mixer = mixer(at, metallic, x);
                let form = at.form.at::<f64>(x, 1.0);
                let mixed = |rho: f64| mixer.mix(rho, &mixer.metal(rho));
                let value = |rho: f64| form.value(&mixed(rho)[0]);
                let (start, found) = (f64::from(found[0].0[x]), f64::from(found[1].0[x]));
                let (at_start, mut least) = (value(start), value(found));
                let mut best = if at_start < least { start } else { found };
                least = if at_start < least { at_start } else { least };
                if EXACT > 0 {
                    let mut rho = best;
                    for _ in 0..EXACT {
                        let [mix, by_rho] = mixed(rho);
                        let (slope, bend) = form.slope_and_bend(&mix, &by_rho);
                        let next = rho - slope / (bend.abs() + f64::MIN_POSITIVE);
                        // A comparison with NaN is false: then the albedo stays where it is.
                        rho = if next > 0.0 { next } else { 0.0 };
                        rho = if rho < 1.0 { rho } else { 1.0 };
                    }
                    let value = value(rho);
                    // Of equals the later one: the first is rounded to float32.
                    best = if value <= least { rho } else { best };
                    least = if value <= least { value } else { least };
                }
                albedo.0[x] = best;
                let left = least + of_tt.0[x];
                // Rounding may leave less than nothing of a sum of squares.
                sum_sq_residuals.0[x] += if left > 0.0 { left } else { 0.0 };
            }
        }
    }
}

#[inline(always)]
fn mixer(at: &AtRoughness, metallic: &Doubles, x: usize) -> Mixer {
    let surface = Surface::new(at.a.0[x], at.b.0[x], at.mean.0[x], at.glass.0[x]);
    Mixer::new(metallic.0[x], surface)
}

/// The lowest of [`STARTS`], and `STEPS` of Newton's method from there.
#[inline(always)]
fn search<const STEPS: usize>(at: &AtRoughness, metallic: &Doubles, found: &mut [Plane<f32>; 2]) {
    for x in 0..BLOCK {
        let surface = Surface::new(
            at.a.0[x] as f32,
            at.b.0[x] as f32,
            at.mean.0[x] as f32,
            at.glass.0[x] as f32,
        );
        let mixer = Mixer::new(metallic.0[x] as f32, surface);
        let form = at.form.at::<f32>(x, at.scale.0[x]);
        let mixed = |rho: f32| mixer.mix(rho, &mixer.metal(rho));
        let value = |rho: f32| form.value(&mixed(rho)[0]);
        let mut best = STARTS[0];
        let mut least = value(best);
        for start in STARTS {
            let value = value(start);
            best = if value < least { start } else { best };
            least = if value < least { value } else { least };
        }
        let mut rho = best;
        for _ in 0..STEPS {
            let [mix, by_rho] = mixed(rho);
            let (slope, bend) = form.slope_and_bend(&mix, &by_rho);
            let next = rho - slope / (bend.abs() + f32::MIN_POSITIVE);
            // A comparison with NaN is false: then the albedo stays where it is.
            rho = if next > 0.0 { next } else { 0.0 };
            rho = if rho < 1.0 { rho } else { 1.0 };
        }
        [found[0].0[x], found[1].0[x]] = [best, rho];
    }
}
