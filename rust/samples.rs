//! The samples of a block of pixels, one at a time: residual, and derivatives by the unknowns.
//!
//! A pixel sees five numbers of a light: Σ_k A_l Y_k(n) L_k and, for each band, Σ_{k in l}
//! Y_k(mirror) L_k. Radiance and its derivatives by the material are linear in them, with
//! coefficients that no picture changes ([`FillResponses`]). Those by the two tilts of a free normal
//! are Σ_k L_k ∂w_ck/∂a, with the derivatives of the weights from [`tilted`](crate::tilted).
//!
//! Code is compiled for pixels whose normals are given, with D = 3 derivatives of a sample and U = 5
//! unknowns of a pixel at most, and for free ones, with 5 and 7.

use crate::block::{
    BLOCK, Basis, BlockBands, ChannelFactors, Directions, FillBands, FillBasis, FillFactors,
    FillWeights, Materials, Plane, Radiance, SEEN, seen,
};
use crate::ggx::Bands;
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;
use crate::shade::{Factors, Material};
use crate::simd::{Instructions, Isa, Kernel};
use crate::tilted::{TILTS, Tilted};
use crate::turns::Tilts;

/// By what radiance is derived in one channel where normals are given: its albedo, roughness,
/// metallic.
pub(crate) const DERIVATIVES: usize = 3;
/// Unknowns of a pixel at most, where normals are given.
pub(crate) const UNKNOWNS: usize = 5;
/// Derivatives and unknowns where normals are free: the tilts follow.
pub(crate) const FREE_DERIVATIVES: usize = DERIVATIVES + TILTS;
pub(crate) const FREE_UNKNOWNS: usize = UNKNOWNS + TILTS;

type Doubles = Plane<f64>;

/// `f::<C, D, U>(…)` for the kind of problem.
macro_rules! by_kind {
    ($problem:expr, $f:ident($($argument:expr),*)) => {{
        use $crate::samples::{DERIVATIVES, FREE_DERIVATIVES, FREE_UNKNOWNS, UNKNOWNS};
        match ($problem.channels(), $problem.free_normals()) {
            (1, false) => $f::<1, DERIVATIVES, UNKNOWNS>($($argument),*),
            (_, false) => $f::<3, DERIVATIVES, UNKNOWNS>($($argument),*),
            (1, true) => $f::<1, FREE_DERIVATIVES, FREE_UNKNOWNS>($($argument),*),
            (_, true) => $f::<3, FREE_DERIVATIVES, FREE_UNKNOWNS>($($argument),*),
        }
    }};
}
pub(crate) use by_kind;

/// Where the derivatives of a channel belong among the unknowns of a pixel: albedo by channel,
/// roughness, metallic, tilts.
pub(crate) fn unknowns_of_channel<const C: usize, const D: usize>(channel: usize) -> [usize; D] {
    std::array::from_fn(|j| if j == 0 { channel } else { C + j - 1 })
}

/// The unknowns that are handed out, in order: all but a known metallic.
pub(crate) fn handed_out<const C: usize, const D: usize>(problem: &Problem) -> Vec<usize> {
    let known = problem.known_metallic().is_some();
    (0..C + D - 1)
        .filter(|&unknown| !(known && unknown == C + 1))
        .collect()
}

/// Up to [`BLOCK`] pixels, picked from anywhere, and one of their samples at a time.
pub(crate) struct Block<'a, const C: usize, const D: usize> {
    problem: &'a Problem,
    isa: Instructions,
    /// Where the pixels come from.
    places: Vec<usize>,
    directions: Directions<f64>,
    pub materials: Materials<C>,
    basis: Basis<f64>,
    bands: BlockBands,
    factors: [ChannelFactors<f64>; C],
    /// w_ck
    pub weights: Vec<[Doubles; COEFFICIENTS]>,
    responses: Vec<Responses>,
    /// Where D says that normals are free.
    pub tilted: Option<Tilted>,
    /// Targets and weights ω: (channel, picture).
    given: Vec<[Doubles; 2]>,
    sample: Sample<D>,
}

/// By which the numbers that a pixel sees of a light become radiance and its derivatives.
#[derive(Clone, Debug, Default)]
struct Responses {
    radiance: [Doubles; SEEN],
    derivatives: [[Doubles; SEEN]; DERIVATIVES],
}

/// One channel of one picture.
#[derive(Clone, Debug)]
pub(crate) struct Sample<const D: usize> {
    /// I − T
    pub residual: Doubles,
    /// ω; 0 where no pixel is.
    pub weight: Doubles,
    /// ∂I/∂(albedo, roughness, metallic), and by the tilts.
    pub derivatives: [Doubles; D],
}

impl<const D: usize> Default for Sample<D> {
    fn default() -> Self {
        Self {
            residual: Doubles::default(),
            weight: Doubles::default(),
            derivatives: [Doubles::default(); D],
        }
    }
}

impl<'a, const C: usize, const D: usize> Block<'a, C, D> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.instructions(),
            places: Vec::new(),
            directions: Directions::default(),
            materials: Materials::default(),
            basis: Basis::default(),
            bands: BlockBands::default(),
            factors: std::array::from_fn(|_| ChannelFactors::default()),
            weights: vec![[Doubles::default(); COEFFICIENTS]; C],
            responses: vec![Responses::default(); C],
            tilted: (D > DERIVATIVES).then(|| Tilted::new(C)),
            given: Vec::new(),
            sample: Sample::default(),
        }
    }

    /// Takes up pixels with their materials, and tilts, of `maps`.
    pub(crate) fn load(&mut self, maps: &[f64], pixels: &[usize]) {
        let mut materials = Materials::default();
        for (x, &p) in pixels.iter().enumerate() {
            materials.set(x, &self.problem.material(maps, p));
        }
        self.place(maps, pixels);
        let tilts = self.problem.picked_tilts(maps, pixels);
        self.take(&materials, &tilts);
    }

    /// Takes up pixels, whose materials, and tilts where they are free, are still to come.
    pub(crate) fn place(&mut self, maps: &[f64], pixels: &[usize]) {
        self.places.clear();
        self.places.extend(pixels);
        self.given.clear();
        for c in 0..C {
            for picture in 0..self.problem.pictures() {
                self.given
                    .push(self.problem.picked_samples(c, picture, pixels));
            }
        }
        if let Some(tilted) = &mut self.tilted {
            tilted.place(self.problem, pixels);
            return;
        }
        self.directions = self.problem.picked_directions(maps, pixels);
        self.fill_basis();
    }

    fn fill_basis(&mut self) {
        self.isa.run(FillBasis::<f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
        });
    }

    /// Gives the pixels materials and, where they are free, tilts, and works out all that no picture
    /// changes.
    pub(crate) fn take(&mut self, materials: &Materials<C>, tilts: &Tilts) {
        self.materials = materials.clone();
        if let Some(tilted) = &mut self.tilted {
            tilted.turn(self.isa, tilts, &mut self.directions);
            self.fill_basis();
        }
        self.isa.run(FillBands {
            roughness: &self.materials.roughness,
            bands: &mut self.bands,
        });
        for c in 0..C {
            self.isa.run(FillResponses {
                directions: &self.directions,
                albedo: &self.materials.albedo[c],
                roughness: &self.materials.roughness,
                metallic: &self.materials.metallic,
                bands: &self.bands,
                responses: &mut self.responses[c],
            });
        }
        if let Some(tilted) = &mut self.tilted {
            tilted.fill(
                self.isa,
                &self.directions,
                &self.basis,
                &self.materials,
                &self.bands,
            );
        }
    }

    /// Works out the derivatives by the lights.
    pub(crate) fn fill_weights(&mut self) {
        self.isa.run(FillFactors {
            directions: &self.directions,
            materials: &self.materials,
            pixels: self.places.len(),
            bands: &mut self.bands,
            factors: &mut self.factors,
        });
        for (factors, weights) in self.factors.iter().zip(&mut self.weights) {
            self.isa.run(FillWeights {
                basis: &self.basis,
                factors,
                weights,
            });
        }
    }

    /// Adds all samples to the normal equations.
    pub(crate) fn add_samples<const U: usize>(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        sums: &mut Sums<U>,
    ) {
        let isa = self.isa;
        self.each_sample(lights, |c, _, sample| {
            isa.run(AddSample {
                sample,
                unknowns: unknowns_of_channel::<C, D>(c),
                sums,
            });
        });
    }

    /// Calls `f` with channel, picture and sample, channel by channel. Lights are (channel, picture).
    pub fn each_sample(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        mut f: impl FnMut(usize, usize, &Sample<D>),
    ) {
        for (c, of_channel) in lights.chunks(self.problem.pictures()).enumerate() {
            for (picture, light) in of_channel.iter().enumerate() {
                self.take_sample(c, picture, light);
                f(c, picture, &self.sample);
            }
        }
    }

    /// Works out one channel of one picture.
    fn take_sample(&mut self, channel: usize, picture: usize, light: &[f64; COEFFICIENTS]) {
        let [target, weight] = &self.given[channel * self.problem.pictures() + picture];
        self.sample.weight = *weight;
        self.isa.run(TakeSample {
            basis: &self.basis,
            light,
            target,
            responses: &self.responses[channel],
            by_tilts: self.tilted.as_ref().map(|t| &t.weights[channel]),
            sample: &mut self.sample,
        });
    }
}

/// Fills in the coefficients of one channel: what [`Factors`] make of each seen number alone.
struct FillResponses<'a> {
    directions: &'a Directions<f64>,
    albedo: &'a Doubles,
    roughness: &'a Doubles,
    metallic: &'a Doubles,
    bands: &'a BlockBands,
    responses: &'a mut Responses,
}

impl Kernel for FillResponses<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for x in 0..BLOCK {
            let material = Material {
                albedo: [self.albedo.0[x]],
                roughness: self.roughness.0[x],
                metallic: self.metallic.0[x],
            };
            let mut bands = Bands {
                weight: [0.0; 4],
                slope: [0.0; 4],
            };
            for l in 0..4 {
                bands.weight[l] = self.bands[l].0[x];
                bands.slope[l] = self.bands[4 + l].0[x];
            }
            let factors = Factors::new(self.directions.cosine(x), &material, bands);
            // One call, in a loop: of several the compiler would make a function and no vector code.
            for seen in 0..SEEN {
                let mut alone = [0.0; SEEN];
                alone[seen] = 1.0;
                let [by_diffuse, by_band @ ..] = alone;
                let derivatives = factors.pull_back(&material, &[by_diffuse], &[by_band]);
                self.responses.radiance[seen].0[x] = if seen == 0 {
                    factors.diffuse[0]
                } else {
                    factors.specular[0] * bands.weight[seen - 1]
                };
                self.responses.derivatives[0][seen].0[x] = derivatives.albedo[0];
                self.responses.derivatives[1][seen].0[x] = derivatives.roughness;
                self.responses.derivatives[2][seen].0[x] = derivatives.metallic;
            }
        }
    }
}

/// Residual and derivatives of a sample.
struct TakeSample<'a, const D: usize> {
    basis: &'a Basis<f64>,
    light: &'a [f64; COEFFICIENTS],
    target: &'a Doubles,
    responses: &'a Responses,
    /// ∂w_k by each tilt.
    by_tilts: Option<&'a [[Doubles; COEFFICIENTS]; TILTS]>,
    sample: &'a mut Sample<D>,
}

impl<const D: usize> Kernel for TakeSample<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let Self {
            basis,
            light,
            target,
            responses,
            by_tilts,
            sample,
        } = self;
        let seen = seen(basis, light);
        for x in 0..BLOCK {
            sample.residual.0[x] = -target.0[x];
        }
        sample.derivatives[..DERIVATIVES].fill(Doubles::default());
        for s in 0..SEEN {
            for x in 0..BLOCK {
                sample.residual.0[x] += responses.radiance[s].0[x] * seen[s].0[x];
            }
            for j in 0..DERIVATIVES {
                for x in 0..BLOCK {
                    sample.derivatives[j].0[x] += responses.derivatives[j][s].0[x] * seen[s].0[x];
                }
            }
        }
        if let Some(by_tilts) = by_tilts {
            let (_, of_tilts) = sample.derivatives.split_at_mut(DERIVATIVES);
            for (weights, radiance) in by_tilts.iter().zip(of_tilts) {
                let radiance = Radiance {
                    weights,
                    light,
                    radiance,
                };
                radiance.run(isa);
            }
        }
    }
}

/// The normal equations of a block; of the matrix, the lower triangle.
#[derive(Clone, Debug)]
pub(crate) struct Sums<const U: usize> {
    pub(crate) matrix: [[Doubles; U]; U],
    pub(crate) gradient: [Doubles; U],
    pub(crate) squares: Doubles,
}

impl<const U: usize> Default for Sums<U> {
    fn default() -> Self {
        Self {
            matrix: [[Doubles::default(); U]; U],
            gradient: [Doubles::default(); U],
            squares: Doubles::default(),
        }
    }
}

impl<const U: usize> Sums<U> {
    /// Puts some rows and columns of the matrix of one pixel at the beginning of `matrix`.
    pub(crate) fn store_matrix(&self, pixel: usize, rows: &[usize], matrix: &mut [f64]) {
        for (i, &row) in rows.iter().enumerate() {
            for (j, &column) in rows.iter().enumerate() {
                let lower = &self.matrix[row.max(column)][row.min(column)];
                matrix[i * rows.len() + j] = lower.0[pixel];
            }
        }
    }
}

/// Adds a sample to the normal equations.
pub(crate) struct AddSample<'a, const D: usize, const U: usize> {
    pub sample: &'a Sample<D>,
    pub unknowns: [usize; D],
    pub sums: &'a mut Sums<U>,
}

impl<const D: usize, const U: usize> Kernel for AddSample<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            sample,
            unknowns,
            sums,
        } = self;
        let mut weighted = Doubles::default();
        for x in 0..BLOCK {
            weighted.0[x] = sample.weight.0[x] * sample.residual.0[x];
            sums.squares.0[x] += weighted.0[x] * sample.residual.0[x];
        }
        for i in 0..D {
            let by_row = &sample.derivatives[i];
            let gradient = &mut sums.gradient[unknowns[i]];
            for x in 0..BLOCK {
                gradient.0[x] += weighted.0[x] * by_row.0[x];
            }
            for j in 0..=i {
                let by_column = &sample.derivatives[j];
                let entry = &mut sums.matrix[unknowns[i]][unknowns[j]];
                for x in 0..BLOCK {
                    entry.0[x] += sample.weight.0[x] * by_row.0[x] * by_column.0[x];
                }
            }
        }
    }
}
