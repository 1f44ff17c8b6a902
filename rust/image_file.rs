//! Picture files in and out: the one place that names `exr` and `image`.
