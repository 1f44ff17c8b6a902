//! The widest vectors that the processor has, chosen at run time, in safe code.
//!
//! A [`Kernel`] is written once, over any [`Isa`]. [`Instructions::run`] calls the copy that was
//! compiled for the processor it runs on: AVX-512, AVX2 with FMA, NEON, or what every processor of
//! the family has. Everything a kernel calls in its loops must be `#[inline(always)]`, or it is
//! compiled for the oldest processor after all. Where the compiler makes the vectors, a kernel is a
//! function of arrays, called by `vectorized!`.

use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Vectors of `T`.
pub trait Vectors<T>: Copy {
    /// Some numbers side by side.
    type Vector: Copy;
    /// How many.
    const LANES: usize;
    /// The same number in all lanes.
    fn splat(self, value: T) -> Self::Vector;
    /// a + b
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a − b
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a b
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a b + c, rounded once where the processor can.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// The whole vectors in a slice.
    fn of(values: &[T]) -> &[Self::Vector];
    /// The whole vectors in a slice.
    fn of_mut(values: &mut [T]) -> &mut [Self::Vector];
}

/// Vectors of float64.
type Doubles<I> = <I as Vectors<f64>>::Vector;

/// An instruction set.
pub trait Isa: Vectors<f32> + Vectors<f64> {
    /// Vector registers; what a kernel keeps in flight must fit.
    const REGISTERS: usize;
    /// Whether a multiply-add is one operation.
    const FUSED: bool;

    /// a / b
    fn div(self, a: Doubles<Self>, b: Doubles<Self>) -> Doubles<Self>;
    /// √a
    fn sqrt(self, a: Doubles<Self>) -> Doubles<Self>;
    /// The larger.
    fn max(self, a: Doubles<Self>, b: Doubles<Self>) -> Doubles<Self>;
    /// The smaller.
    fn min(self, a: Doubles<Self>, b: Doubles<Self>) -> Doubles<Self>;
    /// `yes` in lanes with a ≥ b, else `no`.
    fn at_least(
        self,
        a: Doubles<Self>,
        b: Doubles<Self>,
        yes: Doubles<Self>,
        no: Doubles<Self>,
    ) -> Doubles<Self>;

    /// The sum of all lanes.
    fn sum(self, a: Doubles<Self>) -> f64;

    /// a b + c in loops that the compiler turns into vectors; it never fuses two operations itself.
    #[inline(always)]
    fn fma(a: f64, b: f64, c: f64) -> f64 {
        if Self::FUSED {
            a.mul_add(b, c)
        } else {
            a * b + c
        }
    }

    /// The same in float32.
    #[inline(always)]
    fn fma32(a: f32, b: f32, c: f32) -> f32 {
        if Self::FUSED {
            a.mul_add(b, c)
        } else {
            a * b + c
        }
    }
}

/// Work that is compiled once for each instruction set.
pub trait Kernel {
    /// What the work results in.
    type Output;
    /// Does it. Implementations must be `#[inline(always)]`.
    fn run<I: Isa>(self, isa: I) -> Self::Output;
}

/// An instruction set that this processor has.
#[derive(Clone, Copy, Debug)]
pub struct Instructions(Arch);

impl Instructions {
    /// The widest there is.
    pub fn best() -> Self {
        Self(Arch::new())
    }

    /// All there are, the widest first.
    pub fn all() -> Vec<Self> {
        let mut all = vec![Self::best()];
        #[cfg(target_arch = "x86_64")]
        if let (Arch::V4(_), Some(v3)) = (Arch::new(), pulp::x86::V3::try_new()) {
            all.push(Self(Arch::V3(v3)));
        }
        if !matches!(all[0].0, Arch::Scalar) {
            all.push(Self(Arch::Scalar));
        }
        all
    }

    /// As people call it.
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Arch::V4(_) => "AVX-512",
            #[cfg(target_arch = "x86_64")]
            Arch::V3(_) => "AVX2 and FMA",
            Arch::Scalar => "baseline",
            #[allow(unreachable_patterns)] // where an architecture has no further sets
            _ => "NEON",
        }
    }

    /// Loops that the compiler turns into vectors of this instruction set; see `vectorized!`.
    pub(crate) fn run_loops<R>(self, loops: impl FnOnce() -> R) -> R {
        self.run(Loops(loops))
    }

    /// Runs the copy of a kernel for this instruction set.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            // pulp's one-lane fallback would be slow: its fused multiply-add is a library call.
            Arch::Scalar => kernel.run(Lanes::<_, false>(Scalar128b)),
            arch => arch.dispatch(Adapter(kernel)),
        }
    }
}

/// `vectorized!(isa, f(…))`: a call whose loops the compiler turns into vectors. The function has to be
/// `#[inline(always)]`.
macro_rules! vectorized {
    ($isa:expr, $call:expr) => {
        $isa.run_loops(
            #[inline(always)]
            || $call,
        )
    };
}
pub(crate) use vectorized;

struct Loops<F>(F);

impl<R, F: FnOnce() -> R> Kernel for Loops<F> {
    type Output = R;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> R {
        (self.0)()
    }
}

struct Adapter<K>(K);

impl<K: Kernel> WithSimd for Adapter<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> K::Output {
        self.0.run(Lanes::<_, true>(simd))
    }
}

/// The vectors of an instruction set; what all processors have are four lanes, multiplication and
/// addition apart.
#[derive(Clone, Copy)]
struct Lanes<S, const FUSED: bool>(S);

impl<S: Simd, const FUSED: bool> Isa for Lanes<S, FUSED> {
    const REGISTERS: usize = if FUSED { S::REGISTER_COUNT } else { 16 };
    const FUSED: bool = FUSED;

    #[inline(always)]
    fn div(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.div_f64s(a, b)
    }
    #[inline(always)]
    fn sqrt(self, a: S::f64s) -> S::f64s {
        self.0.sqrt_f64s(a)
    }
    #[inline(always)]
    fn max(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.max_f64s(a, b)
    }
    #[inline(always)]
    fn min(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.min_f64s(a, b)
    }
    #[inline(always)]
    fn sum(self, a: S::f64s) -> f64 {
        self.0.reduce_sum_f64s(a)
    }
    #[inline(always)]
    fn at_least(self, a: S::f64s, b: S::f64s, yes: S::f64s, no: S::f64s) -> S::f64s {
        (self.0).select_f64s(self.0.greater_than_or_equal_f64s(a, b), yes, no)
    }
}

macro_rules! vectors {
    ($t:ty, $vector:ident, $lanes:ident, $of:ident, $of_mut:ident,
     $splat:ident, $add:ident, $sub:ident, $mul:ident, $mul_add:ident) => {
        impl<S: Simd, const FUSED: bool> Vectors<$t> for Lanes<S, FUSED> {
            type Vector = S::$vector;
            const LANES: usize = S::$lanes;
            #[inline(always)]
            fn splat(self, value: $t) -> S::$vector {
                self.0.$splat(value)
            }
            #[inline(always)]
            fn add(self, a: S::$vector, b: S::$vector) -> S::$vector {
                self.0.$add(a, b)
            }
            #[inline(always)]
            fn sub(self, a: S::$vector, b: S::$vector) -> S::$vector {
                self.0.$sub(a, b)
            }
            #[inline(always)]
            fn mul(self, a: S::$vector, b: S::$vector) -> S::$vector {
                self.0.$mul(a, b)
            }
            #[inline(always)]
            fn mul_add(self, a: S::$vector, b: S::$vector, c: S::$vector) -> S::$vector {
                if FUSED {
                    self.0.$mul_add(a, b, c)
                } else {
                    self.0.$add(self.0.$mul(a, b), c)
                }
            }
            #[inline(always)]
            fn of(values: &[$t]) -> &[S::$vector] {
                S::$of(values).0
            }
            #[inline(always)]
            fn of_mut(values: &mut [$t]) -> &mut [S::$vector] {
                S::$of_mut(values).0
            }
        }
    };
}

vectors!(
    f32,
    f32s,
    F32_LANES,
    as_simd_f32s,
    as_mut_simd_f32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    mul_add_f32s
);
vectors!(
    f64,
    f64s,
    F64_LANES,
    as_simd_f64s,
    as_mut_simd_f64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    mul_add_f64s
);
