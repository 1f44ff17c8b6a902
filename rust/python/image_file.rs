//! `pbrfit._core`: reading and writing picture files.

use std::path::PathBuf;

use numpy::{
    Element, Ix3, PyArray1, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn,
    PyReadwriteArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};

use super::arrays::{ANY, Contiguous, array, copied, given, shape};
use crate::image_file::{self, ExrChannel, Format, PngTag, Samples, Stored};
use crate::runtime::{Error, Result};

/// A decoded picture file: samples as stored, nothing converted.
#[pyclass(frozen, get_all, module = "pbrfit._core")]
pub(super) struct Raster {
    format: &'static str,
    samples: Py<PyAny>,
    icc_profile: Option<Py<PyBytes>>,
    exif: Option<Py<PyBytes>>,
    orientation: u8,
    code_points: Option<[u8; 2]>,
    gamma: Option<f32>,
    chromaticities: Option<[(f32, f32); 4]>,
    passed_over: usize,
}

/// The format by the first bytes: EXR, PNG, JPEG, TIFF, HDR or None.
#[pyfunction]
pub(super) fn image_format(data: PyBackedBytes) -> Option<&'static str> {
    Format::of(&data).map(Format::name)
}

/// Channels by name, chromaticities, and names of colour spaces.
type Exr<'py> = (Bound<'py, PyDict>, Option<[(f32, f32); 4]>, Vec<String>);

/// Channels by name, (H, W) float32 each, and what attributes say of their colour.
#[pyfunction]
pub(super) fn decode_exr<'py>(
    py: Python<'py>,
    data: PyBackedBytes,
    path: PathBuf,
) -> PyResult<Exr<'py>> {
    let exr = py.detach(|| image_file::decode_exr(&data, &path))?;
    let channels = PyDict::new(py);
    for ExrChannel { name, values } in exr.channels {
        let plane = PyArray1::from_vec(py, values).reshape([exr.height, exr.width])?;
        channels.set_item(name, plane)?;
    }
    Ok((channels, exr.chromaticities, exr.color_spaces))
}

/// The number of pictures in a TIFF file.
#[pyfunction]
pub(super) fn tiff_pages(py: Python<'_>, path: PathBuf) -> PyResult<usize> {
    Ok(py.detach(|| image_file::count_tiff_pages(&path))?)
}

/// PNG, JPEG, TIFF or HDR. `indices`: palette and low-bit values as stored; `page` of a TIFF.
#[pyfunction]
#[pyo3(signature = (data, path, indices, page=None))]
pub(super) fn decode_raster(
    py: Python<'_>,
    data: PyBackedBytes,
    path: PathBuf,
    indices: bool,
    page: Option<usize>,
) -> PyResult<Raster> {
    let raster = py.detach(|| image_file::decode_raster(&data, &path, indices, page))?;
    let shape = [raster.height, raster.width, raster.channels];
    let samples = match raster.samples {
        Samples::U8(values) => PyArray1::from_vec(py, values).reshape(shape)?.into_any(),
        Samples::U16(values) => PyArray1::from_vec(py, values).reshape(shape)?.into_any(),
        Samples::F32(values) => PyArray1::from_vec(py, values).reshape(shape)?.into_any(),
    };
    let bytes = |bytes: Option<Vec<u8>>| bytes.map(|bytes| PyBytes::new(py, &bytes).unbind());
    Ok(Raster {
        format: raster.format.name(),
        samples: samples.unbind(),
        icc_profile: bytes(raster.icc_profile),
        exif: bytes(raster.exif),
        orientation: raster.orientation,
        code_points: raster.code_points,
        gamma: raster.gamma,
        chromaticities: raster.chromaticities,
        passed_over: raster.passed_over,
    })
}

/// Tone curves of an ICC profile and its matrix.
type Curves<'py> = (Vec<Bound<'py, PyArray1<f32>>>, Option<[[f64; 3]; 3]>);

/// Curves sampled at `levels` levels and the matrix to CIE XYZ under D50.
#[pyfunction]
pub(super) fn decode_icc(
    py: Python<'_>,
    profile: PyBackedBytes,
    levels: usize,
    path: PathBuf,
) -> PyResult<Curves<'_>> {
    let icc = py.detach(|| image_file::decode_icc(&profile, levels, &path))?;
    let curves = icc
        .curves
        .into_iter()
        .map(|curve| PyArray1::from_vec(py, curve))
        .collect();
    Ok((curves, icc.to_xyz))
}

/// Fills linear light (h, w, 3) with the means of `used` rows and columns of samples (H, W, C):
/// integers through curves (1 or 3, levels), floats as they are. Marks in zeros (h, w, 3) which
/// colours are limited by integers outside of `codes`; returns whether one is.
#[pyfunction]
pub(super) fn average_light<'py>(
    samples: &Bound<'py, PyAny>,
    used: [[usize; 2]; 2],
    curves: &Bound<'py, PyAny>,
    codes: Option<[u16; 2]>,
    colors: [[u8; 3]; 27],
    pixels: PyReadwriteArray3<'py, f32>,
    limits: PyReadwriteArray3<'py, u8>,
) -> PyResult<bool> {
    let (curves, [count, levels]) = given::<f32, 2>("curves", curves, [ANY, ANY])?;
    let curve = |c: usize| &curves[c % count * levels..][..levels];
    let to = (pixels, limits);
    match samples.getattr("dtype")?.getattr("itemsize")?.extract()? {
        1 => {
            let codes = codes.map(|codes| codes.map(|code| code as u8));
            let light = |c| value::<u8>(curve(c));
            average(samples, used, light, (codes, &colors), to)
        }
        2 => {
            let light = |c| value::<u16>(curve(c));
            average(samples, used, light, (codes, &colors), to)
        }
        _ => average(samples, used, |_| |light: f32| light, (None, &colors), to),
    }
}

/// A sampled curve at codes.
fn value<T: Into<usize>>(curve: &[f32]) -> impl Fn(T) -> f32 {
    |code| curve[code.into()]
}

fn average<'py, T: Element + Copy + PartialOrd + Sync, V: Fn(T) -> f32>(
    samples: &Bound<'py, PyAny>,
    used: [[usize; 2]; 2],
    curve: impl Fn(usize) -> V + Send,
    bounds: (Option<[T; 2]>, &[[u8; 3]; 27]),
    (mut pixels, mut limits): (PyReadwriteArray3<'py, f32>, PyReadwriteArray3<'py, u8>),
) -> PyResult<bool> {
    let given = array::<T, Ix3>("samples", samples)?;
    let (width, channels) = (given.shape()[1], given.shape()[2]);
    let (high, wide) = (pixels.shape()[0], pixels.shape()[1]);
    shape("pixels", &[high, wide, 3], pixels.shape())?;
    shape("limits", &[high, wide, 3], limits.shape())?;
    // Read where they are: the decoder made them for this alone, and a copy takes a tenth as long.
    let held = Contiguous::try_of("samples", &given)?;
    let stored = Stored {
        samples: held.values(),
        shape: [width, channels],
        used: used.map(|[start, end]| start..end),
    };
    let strided = |_| Error::argument("pixels", "numbers in one piece", "steps between them");
    let pixels = pixels.as_slice_mut().map_err(strided)?;
    let limits = limits.as_slice_mut().map_err(strided)?;
    let work = || image_file::averaged(&stored, [high, wide], curve, bounds, pixels, limits);
    Ok(samples.py().detach(work)?)
}

/// One part, ZIP, Rec.709; all of the file or none of it.
#[pyfunction]
pub(super) fn write_exr(
    py: Python<'_>,
    path: PathBuf,
    channels: Vec<(String, PyReadonlyArray2<'_, f32>)>,
    half: bool,
) -> PyResult<()> {
    let shape = channels
        .first()
        .map_or([0, 0], |(_, plane)| [plane.shape()[0], plane.shape()[1]]);
    let channels = channels
        .into_iter()
        .map(|(name, plane)| {
            let values = copied("channels", &plane)?;
            Ok(ExrChannel { name, values })
        })
        .collect::<Result<Vec<_>>>()?;
    py.detach(|| image_file::write_exr(&path, shape[1], shape[0], channels, half))?;
    Ok(())
}

/// 8 or 16-bit samples, (H, W) or (H, W, C); all of the file or none of it.
#[pyfunction]
pub(super) fn write_png(
    py: Python<'_>,
    path: PathBuf,
    image: Bound<'_, PyAny>,
    tag: Option<&str>,
) -> PyResult<()> {
    let bytes = png(py, &image, tag)?;
    py.detach(|| image_file::write_atomically(&path, &bytes))?;
    Ok(())
}

/// The bytes that `write_png` would write.
#[pyfunction]
pub(super) fn encode_png<'py>(
    py: Python<'py>,
    image: Bound<'_, PyAny>,
    tag: Option<&str>,
) -> PyResult<Bound<'py, PyBytes>> {
    Ok(PyBytes::new(py, &png(py, &image, tag)?))
}

fn png(py: Python<'_>, image: &Bound<'_, PyAny>, tag: Option<&str>) -> PyResult<Vec<u8>> {
    let samples = if let Ok(image) = image.extract::<PyReadonlyArrayDyn<'_, u8>>() {
        Samples::U8(copied("image", &image)?)
    } else if let Ok(image) = image.extract::<PyReadonlyArrayDyn<'_, u16>>() {
        Samples::U16(copied("image", &image)?)
    } else {
        let kind = image.getattr("dtype");
        let kind = kind.unwrap_or_else(|_| image.get_type().into_any());
        return Err(Error::argument("image", "uint8 or uint16", kind).into());
    };
    let shape: Vec<usize> = image.getattr("shape")?.extract()?;
    let shape = match shape[..] {
        [height, width] => [height, width, 1],
        [height, width, channels] => [height, width, channels],
        _ => {
            let found = format!("{shape:?}");
            return Err(Error::argument("image", "(H, W) or (H, W, C)", found).into());
        }
    };
    let tag = match tag {
        Some("srgb") => PngTag::Srgb,
        Some("linear") => PngTag::Linear,
        None => PngTag::Untagged,
        Some(other) => {
            let found = format!("{other:?}");
            return Err(Error::argument("tag", "srgb, linear or None", found).into());
        }
    };
    Ok(py.detach(|| image_file::encode_png(&samples, shape, tag))?)
}
