//! The pictures of one scene, and the loss over them with its gradient by every unknown.

pub(crate) mod by_pixel;
mod evaluate;
pub mod render;
mod surroundings;
pub mod targets;

use std::ops::Range;

use glam::DVec3;

use self::targets::Targets;
use crate::block::normal_jacobian::{GivenDirections, TangentOffsets};
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::{BLOCK, Directions, Material, Plane};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset;
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::collect;
use crate::runtime::simd::{Instructions, vectorized};
use crate::runtime::{Error, Result, check};
use crate::transport::table::Transfer;

/// Pieces of work at most. Their borders depend on the pixel count alone, and their
/// results are added in order, so every sum is the same at any number of threads.
const MAX_CHUNKS: usize = 64;

/// Blocks in a piece of work at least: a piece has a cost of its own.
const MIN_CHUNK: usize = 4;

/// The materials in x, as messages name them.
const MAPS_OF_X: &str = "x (albedo, roughness, metallic)";

/// The tangent offsets in x, as messages name them.
const OFFSETS_OF_X: &str = "x (tangent offset)";

/// What is given to a [`Problem`].
#[derive(Clone, Debug)]
pub struct Pictures<'a> {
    /// Linear radiance.
    pub images: Targets,
    /// Weight of each sample, in \[0, 1\]: (picture, pixel), or (picture, pixel, channel).
    pub weights: Option<&'a [f32]>,
    /// Unit vectors, one a pixel.
    pub normals: &'a [DVec3],
    /// Unit vectors from the surface to the camera, one a pixel.
    pub views: &'a [DVec3],
    /// What takes the place of the model's rows, where surroundings block light or bring some.
    pub transfer: Option<Transfer>,
}

/// What is known beforehand, and so costs nothing in an evaluation; and how to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Highest band of the lights, 2 or 3.
    pub sh_order: usize,
    /// Metallic of all pixels, where it is no unknown.
    pub metallic: Option<f64>,
    /// The lights, where they are no unknowns: (picture, coefficient, channel).
    pub lighting: Option<Vec<f64>>,
    /// Whether the normals are unknowns too: x then has a [`tangent_offset`] for each pixel.
    pub free_normals: bool,
    /// What makes radiance of materials.
    pub model: Model,
    /// 0 means one for each processor.
    pub threads: usize,
    /// The vector instructions to use.
    pub instructions: Instructions,
}

impl Default for Options {
    /// Everything unknown but the normals, order 3, all processors, the widest vectors.
    fn default() -> Self {
        Self {
            sh_order: 3,
            metallic: None,
            lighting: None,
            free_normals: false,
            model: Model::Paper,
            threads: 0,
            instructions: Instructions::best(),
        }
    }
}

/// The pictures, prepared for repeated evaluation.
///
/// Unknowns are one vector, x = \[albedo (a plane of `pixels` for each channel) | roughness |
/// metallic | tangent offset a | tangent offset b | lighting (picture, coefficient, channel)\],
/// without those that are known; what comes before the lighting are its maps. The loss is the mean
/// of (I − T)² over pixels, pictures and channels, weighted if there are weights.
#[derive(Debug)]
pub struct Problem {
    pub(crate) options: Options,
    /// Sum of the weights of all samples and channels.
    total_weight: f64,
    /// Normals and views, by block.
    pub(crate) given: Vec<GivenDirections>,
    /// What takes the place of the model's rows, if anything does.
    pub(crate) transfer: Option<Transfer>,
    targets: Targets,
    /// With one channel where all share a weight.
    weights: Option<Targets>,
}

impl Problem {
    /// Checks what is given, and chooses the kernel for it.
    pub fn new(given: Pictures, options: Options) -> Result<Self> {
        let Pictures {
            images: targets,
            weights,
            normals,
            views,
            transfer,
        } = given;
        targets.complete()?;
        let [pixels, pictures, channels] = [targets.pixels, targets.pictures, targets.channels];
        check::length("normals", pixels, normals.len())?;
        check::length("views", pixels, views.len())?;
        check::unit_vectors("normals", normals)?;
        check::unit_vectors("views", views)?;
        if !matches!(options.sh_order, 2 | 3) {
            return Err(Error::argument("sh_order", "2 or 3", options.sh_order));
        }
        let coefficients = (options.sh_order + 1).pow(2);
        if let Some(metallic) = options.metallic {
            check::unit_interval("metallic", &[metallic])?;
        }
        if let Some(lighting) = &options.lighting {
            check::length(
                "lighting",
                pictures * coefficients * channels,
                lighting.len(),
            )?;
            check::moderate("lighting", lighting, LARGEST_F32)?;
        }
        let samples = pictures * pixels;
        let (weights, total_weight) = match weights {
            None => (None, (samples * channels) as f64),
            Some(weights) => {
                let of_sample = if weights.len() == samples {
                    1
                } else {
                    channels
                };
                check::length("weights", samples * of_sample, weights.len())?;
                let total = check::weights("weights", weights)? * (channels / of_sample) as f64;
                let mut planes = Targets::new(pixels, pictures, of_sample, options.threads)?;
                for picture in weights.chunks(pixels * of_sample) {
                    planes.push(picture)?;
                }
                (Some(planes), total)
            }
        };

        if let Some(transfer) = &transfer {
            if options.free_normals {
                let expected = "given normals, which it was made with";
                return Err(Error::argument("transfer", expected, "free ones"));
            }
            let rows = pixels * with_model!(options.model, M => 1 + M::ROWS);
            check::length("transfer", rows * COEFFICIENTS, transfer.rows.len())?;
            check::moderate("transfer", &transfer.rows, LARGEST_F32)?;
            if !transfer.bounced.is_empty() {
                let bounced = rows * pictures * channels;
                check::length("bounced", bounced, transfer.bounced.len())?;
                check::moderate("bounced", &transfer.bounced, LARGEST_F32)?;
            }
        }
        let given = GivenDirections::blocks(normals, views, options.free_normals)?;
        Ok(Self {
            options,
            total_weight,
            given,
            transfer,
            targets,
            weights,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.targets.pixels
    }

    /// Number of pictures.
    pub fn pictures(&self) -> usize {
        self.targets.pictures
    }

    /// Number of colour channels.
    pub fn channels(&self) -> usize {
        self.targets.channels
    }

    /// Coefficients of a light in one channel.
    pub fn coefficients(&self) -> usize {
        (self.options.sh_order + 1).pow(2)
    }

    /// Number of unknowns that are maps, the first part of x.
    pub fn maps(&self) -> usize {
        self.unknowns_of_pixel() * self.pixels()
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        let of_lights = match self.options.lighting {
            None => self.pictures() * self.coefficients() * self.channels(),
            Some(_) => 0,
        };
        self.maps() + of_lights
    }

    /// Unknowns of a pixel: those of its material, and its tangent offset where normals are free.
    pub(crate) fn unknowns_of_pixel(&self) -> usize {
        self.unknowns_of_material() + if self.options.free_normals { 2 } else { 0 }
    }

    /// Unknowns of a pixel's material: albedo, roughness and, unless it is known, metallic.
    pub(crate) fn unknowns_of_material(&self) -> usize {
        self.channels() + 1 + usize::from(self.options.metallic.is_none())
    }

    /// Maps, in their planes of materials and of tangent offsets; the latter empty where normals
    /// are known.
    pub(crate) fn split_maps<'a>(&self, maps: &'a [f64]) -> (&'a [f64], &'a [f64]) {
        maps.split_at(self.unknowns_of_material() * self.pixels())
    }

    /// The normals of all pixels; `maps` is the first part of x.
    pub fn normals(&self, maps: &[f64]) -> Result<Vec<DVec3>> {
        check::length("maps", self.maps(), maps.len())?;
        let (_, offsets) = self.split_maps(maps);
        check::moderate("maps (tangent offset)", offsets, tangent_offset::OFFSET_MAX)?;
        let normals = (0..self.pixels()).map(|p| self.normal(maps, p));
        collect("normals", self.pixels(), normals)
    }

    /// x where some pixels are asked for, checked: its maps, and its lights, known or of x, as
    /// (channel, picture, coefficient), with zeros where a band is left out.
    pub(crate) fn at<'a>(
        &'a self,
        x: &'a [f64],
        pixels: &[usize],
    ) -> Result<(&'a [f64], Vec<[f64; COEFFICIENTS]>)> {
        let (maps, lighting) = self.split(x)?;
        self.check_maps(maps)?;
        check::indices("pixels", self.pixels(), pixels)?;
        Ok((maps, self.padded_lights(lighting)))
    }

    /// Materials must lie in \[0, 1\]; tangent offsets must be moderate.
    fn check_maps(&self, maps: &[f64]) -> Result<()> {
        let (materials, offsets) = self.split_maps(maps);
        check::unit_interval(MAPS_OF_X, materials)?;
        check::moderate(OFFSETS_OF_X, offsets, tangent_offset::OFFSET_MAX)
    }

    /// The maps of x, and the lights, known or of x.
    fn split<'a>(&'a self, x: &'a [f64]) -> Result<(&'a [f64], &'a [f64])> {
        check::length("x", self.size(), x.len())?;
        let (maps, free) = x.split_at(self.maps());
        let Some(known) = &self.options.lighting else {
            check::moderate("x (lighting)", free, LARGEST_F32)?;
            return Ok((maps, free));
        };
        Ok((maps, known))
    }

    /// The material of a pixel; `maps` is the first part of x.
    pub(crate) fn material<const C: usize>(&self, maps: &[f64], p: usize) -> Material<C> {
        let (roughness, metallic) = self.roughness_and_metallic(maps, p);
        Material {
            albedo: std::array::from_fn(|c| maps[c * self.pixels() + p]),
            roughness,
            metallic,
        }
    }

    /// The same without albedo.
    pub(crate) fn roughness_and_metallic(&self, maps: &[f64], p: usize) -> (f64, f64) {
        let plane = |i: usize| maps[(self.channels() + i) * self.pixels() + p];
        (plane(0), self.options.metallic.unwrap_or_else(|| plane(1)))
    }

    /// The tangent offset of a pixel; 0 where normals are known.
    fn offset(&self, maps: &[f64], p: usize) -> [f64; 2] {
        if !self.options.free_normals {
            return [0.0; 2];
        }
        let (_, offsets) = self.split_maps(maps);
        [offsets[p], offsets[self.pixels() + p]]
    }

    /// Lights (picture, coefficient, channel), of any number of pictures, as (channel, picture,
    /// coefficient), with zeros where a band is left out.
    pub(crate) fn padded_lights(&self, lighting: &[f64]) -> Vec<[f64; COEFFICIENTS]> {
        let (k, channels) = (self.coefficients(), self.channels());
        let mut lights = Vec::with_capacity(lighting.len() / k);
        for channel in 0..channels {
            lights.extend(lighting.chunks(k * channels).map(|of_picture| {
                let mut light = [0.0; COEFFICIENTS];
                for (to, from) in light.iter_mut().zip(of_picture.chunks(channels)) {
                    *to = from[channel];
                }
                light
            }));
        }
        lights
    }

    fn blocks(&self) -> usize {
        self.pixels().div_ceil(BLOCK)
    }

    /// Blocks in a piece of work.
    fn chunk(&self) -> usize {
        self.blocks().div_ceil(MAX_CHUNKS).max(MIN_CHUNK)
    }

    /// The pieces of work, as ranges of blocks.
    pub(crate) fn chunks(&self) -> impl Iterator<Item = Range<usize>> {
        let (chunk, blocks) = (self.chunk(), self.blocks());
        (0..blocks)
            .step_by(chunk)
            .map(move |first| first..(first + chunk).min(blocks))
    }

    /// A plane for each picture.
    pub(crate) fn targets(&self, block: usize, channel: usize) -> &[Plane] {
        self.targets.planes(block, channel)
    }

    /// Where some pixels look, at most [`BLOCK`] of them, from anywhere; at the tangent offsets of x.
    pub(crate) fn picked_directions(&self, maps: &[f64], pixels: &[usize]) -> Directions<f64> {
        let (given, mut picked) = (&self.picked_given(pixels), Directions::default());
        let (directions, isa) = (&mut picked, self.options.instructions);
        if self.options.free_normals {
            let (offsets, mut unused) = (self.picked_offsets(maps, pixels), Default::default());
            vectorized!(isa, given.turn(&offsets, directions, &mut unused));
        } else {
            vectorized!(isa, given.place(directions));
        }
        picked
    }

    /// Given normals and views of some pixels, at most [`BLOCK`] of them.
    pub(crate) fn picked_given(&self, pixels: &[usize]) -> GivenDirections {
        let mut picked = GivenDirections::default();
        for (x, &p) in pixels.iter().enumerate() {
            picked.set(x, self.given[p / BLOCK].get(p % BLOCK));
        }
        picked
    }

    /// The tangent offsets of some pixels; 0 where no pixel is, or normals are known.
    pub(crate) fn picked_offsets(&self, maps: &[f64], pixels: &[usize]) -> TangentOffsets {
        let mut picked = TangentOffsets::default();
        for (x, &p) in pixels.iter().enumerate() {
            let offset = self.offset(maps, p);
            for t in 0..2 {
                picked[t].0[x] = offset[t];
            }
        }
        picked
    }

    /// The normal of a pixel, at its tangent offset if normals are free.
    fn normal(&self, maps: &[f64], p: usize) -> DVec3 {
        let [normal, _] = self.given[p / BLOCK].get(p % BLOCK);
        if !self.options.free_normals {
            return normal;
        }
        tangent_offset::offset_normal(normal, self.offset(maps, p)).normal
    }

    /// Targets and weights of some pixels, at most [`BLOCK`]: (channel, picture); 0 where no pixel is.
    pub(crate) fn pick_samples(&self, pixels: &[usize], picked: &mut Vec<[Plane<f64>; 2]>) {
        let samples = self.channels() * self.pictures();
        if pixels.len() < BLOCK {
            picked.clear();
        }
        picked.resize(samples, Default::default());
        // A whole block, as it lies there, is copied in vectors.
        let first = pixels.first().map_or(0, |&p| p);
        let whole = pixels.len() == BLOCK
            && first.is_multiple_of(BLOCK)
            && pixels.iter().enumerate().all(|(x, &p)| p == first + x);
        for (sample, [target, weight]) in picked.iter_mut().enumerate() {
            let (channel, picture) = (sample / self.pictures(), sample % self.pictures());
            if whole {
                let block = first / BLOCK;
                self.targets.copy(block, channel, picture, target);
                match self.weights(block, channel).get(picture) {
                    Some(weights) => widen(weights, weight),
                    None => weight.0.fill(1.0),
                }
                continue;
            }
            for (x, &p) in pixels.iter().enumerate() {
                let (block, there) = (p / BLOCK, p % BLOCK);
                target.0[x] = self.targets.get(block, channel, picture, there);
                let weights = self.weights(block, channel);
                weight.0[x] = weights.get(picture).map_or(1.0, |w| w.0[there].into());
            }
        }
    }

    /// Gram matrices that lights of a channel have: 1, or one a picture where samples have weights.
    pub(crate) fn grams(&self) -> usize {
        if self.weights.is_none() {
            1
        } else {
            self.pictures()
        }
    }

    /// A plane for each picture, or none where all samples weigh the same.
    pub(crate) fn weights(&self, block: usize, channel: usize) -> &[Plane] {
        let weights = self.weights.as_ref();
        weights.map_or(&[], |w| w.planes(block, channel % w.channels))
    }
}

/// The same numbers in double precision.
pub(crate) fn widen(from: &Plane, to: &mut Plane<f64>) {
    for x in 0..BLOCK {
        to.0[x] = from.0[x].into();
    }
}

pub(crate) fn add(total: &mut [f64], partial: &[f64]) {
    for (t, p) in total.iter_mut().zip(partial) {
        *t += p;
    }
}

/// Planes of `pixels` values each, cut into pieces of `chunk` of them.
fn chunks_of_planes(
    maps: &mut [f64],
    pixels: usize,
    chunk: usize,
) -> impl Iterator<Item = Vec<&mut [f64]>> {
    let mut planes: Vec<_> = maps
        .chunks_mut(pixels)
        .map(|plane| plane.chunks_mut(chunk))
        .collect();
    (0..pixels.div_ceil(chunk)).map(move |_| {
        let pieces = planes.iter_mut().map(Iterator::next);
        pieces.map(|piece| piece.expect("equal planes")).collect()
    })
}
