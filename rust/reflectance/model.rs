//! Which reflection model makes weights of materials.

use std::str::FromStr;

use crate::runtime::Error;

/// A reflection model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// The paper's eq. 12: a lobe round about the mirror direction, masked at the view angle.
    #[default]
    Paper,
    /// The exact response of the microfacet model that Blender, glTF and game engines share.
    Principled,
}

/// `with_model!(model, M => f::<M>(…))`: code that is compiled for each model, with its type as M; with
/// `true` before it, for pixels among surroundings.
macro_rules! with_model {
    ($model:expr, $type:ident => $code:expr) => {
        $crate::reflectance::model::with_model!($model, false, $type => $code)
    };
    ($model:expr, $surrounded:literal, $type:ident => $code:expr) => {
        match $model {
            $crate::reflectance::model::Model::Paper => {
                type $type = $crate::reflectance::paper::Paper<$surrounded>;
                $code
            }
            $crate::reflectance::model::Model::Principled => {
                type $type = $crate::reflectance::principled::Principled<$surrounded>;
                $code
            }
        }
    };
}
pub(crate) use with_model;

/// The same for the model of a problem, which may be one among surroundings.
macro_rules! with_model_of {
    ($problem:expr, $type:ident => $code:expr) => {
        if $problem.transfer.is_some() {
            $crate::reflectance::model::with_model!($problem.options.model, true, $type => $code)
        } else {
            $crate::reflectance::model::with_model!($problem.options.model, $type => $code)
        }
    };
}
pub(crate) use with_model_of;

impl FromStr for Model {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match name {
            "paper" => Ok(Self::Paper),
            "principled" => Ok(Self::Principled),
            _ => Err(Error::argument("model", "paper or principled", name)),
        }
    }
}
