//! Pictures as they come in: an array of all, or one after the other.

use numpy::{
    PyArrayDescrMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArray, PyUntypedArrayMethods,
    dtype,
};
use pyo3::prelude::*;
use pyo3::types::PyIterator;

use super::arrays::{Contiguous, array, shape};
use crate::problem::targets::Targets;
use crate::runtime::{Error, Result};

/// An array (N, P, C) of float32, or anything with a length that gives arrays (P, C), of float32 or
/// of float64, one after the other.
pub(super) struct Images<'py> {
    /// (pictures, pixels, channels)
    pub(super) shape: [usize; 3],
    first: Option<Picture<'py>>,
    others: Bound<'py, PyIterator>,
}

/// (pixels, channels)
enum Picture<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

impl<'py> Images<'py> {
    pub(super) fn of(images: &Bound<'py, PyAny>) -> PyResult<Self> {
        if images.cast::<PyUntypedArray>().is_err()
            && let (Ok(count), Ok(mut pictures)) = (images.len(), images.try_iter())
        {
            let first = pictures
                .next()
                .ok_or_else(|| Error::argument("images", "at least one picture", "none"))?;
            let first = Picture::of(&first?)?;
            let &[pixels, channels] = first.shape() else {
                unreachable!("an array of two dimensions");
            };
            return Ok(Self {
                shape: [count, pixels, channels],
                first: Some(first),
                others: pictures,
            });
        }
        let images: PyReadonlyArray3<'py, f32> = array("images", images)?;
        let &[pictures, pixels, channels] = images.shape() else {
            unreachable!("an array of three dimensions");
        };
        Ok(Self {
            shape: [pictures, pixels, channels],
            first: None,
            others: images.as_any().try_iter()?,
        })
    }

    /// The pictures in planes.
    pub(super) fn targets(self, threads: usize) -> PyResult<Targets> {
        let [pictures, pixels, channels] = self.shape;
        let mut targets = Targets::new(pixels, pictures, channels, threads)?;
        if let Some(first) = self.first {
            first.push_to(&mut targets)?;
        }
        for picture in self.others {
            let picture = Picture::of(&picture?)?;
            shape("images", &[pixels, channels], picture.shape())?;
            picture.push_to(&mut targets)?;
        }
        Ok(targets)
    }
}

impl<'py> Picture<'py> {
    fn of(picture: &Bound<'py, PyAny>) -> PyResult<Self> {
        match picture.cast::<PyUntypedArray>() {
            Ok(found) if found.dtype().is_equiv_to(&dtype::<f64>(picture.py())) => {
                array("images", picture).map(Self::Double)
            }
            _ => array("images", picture).map(Self::Single),
        }
    }

    fn shape(&self) -> &[usize] {
        match self {
            Self::Single(picture) => picture.shape(),
            Self::Double(picture) => picture.shape(),
        }
    }

    fn push_to(self, targets: &mut Targets) -> Result<()> {
        match self {
            Self::Single(picture) => targets.push(Contiguous::try_of("images", &picture)?.values()),
            Self::Double(picture) => targets.push(Contiguous::try_of("images", &picture)?.values()),
        }
    }
}
