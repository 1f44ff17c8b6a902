//! A number, or one in each lane of a vector: formulas are written once for both.

use std::ops::{Add, Div, Mul, Sub};

use glam::DVec3;

use crate::runtime::simd::{Isa, Vectors};

/// What formulas need, with single numbers of all lanes on the right.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// The same number in all lanes.
    fn all(self, value: f64) -> Self;
    /// Its root.
    fn sqrt(self) -> Self;
    /// The larger of both.
    fn max(self, other: Self) -> Self;
    /// The smaller of both.
    fn min(self, other: Self) -> Self;
    /// `yes` where it is at least so much, else `no`.
    fn at_least(self, least: f64, yes: Self, no: Self) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn all(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.max(other)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.min(other)
    }
    #[inline(always)]
    fn at_least(self, least: f64, yes: Self, no: Self) -> Self {
        if self >= least { yes } else { no }
    }
}

/// A vector of an instruction set.
#[derive(Clone, Copy)]
pub(super) struct Wide<I: Isa>(pub(super) I, pub(super) <I as Vectors<f64>>::Vector);

macro_rules! operator {
    ($operator:ident, $name:ident, $call:path) => {
        impl<I: Isa> $operator for Wide<I> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(self.0, $call(self.0, self.1, other.1))
            }
        }
        impl<I: Isa> $operator<f64> for Wide<I> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                Self(self.0, $call(self.0, self.1, self.0.splat(other)))
            }
        }
    };
}

operator!(Add, add, Vectors::<f64>::add);
operator!(Sub, sub, Vectors::<f64>::sub);
operator!(Mul, mul, Vectors::<f64>::mul);
operator!(Div, div, Isa::div);

impl<I: Isa> Number for Wide<I> {
    #[inline(always)]
    fn all(self, value: f64) -> Self {
        Self(self.0, self.0.splat(value))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0, self.0.sqrt(self.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0, self.0.max(self.1, other.1))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0, self.0.min(self.1, other.1))
    }
    #[inline(always)]
    fn at_least(self, least: f64, yes: Self, no: Self) -> Self {
        let least = self.0.splat(least);
        Self(self.0, self.0.at_least(self.1, least, yes.1, no.1))
    }
}

/// A vector of space.
pub type Vector<T> = [T; 3];

#[inline(always)]
pub(super) fn dot<T: Number>(a: Vector<T>, b: DVec3) -> T {
    a[0] * b.x + a[1] * b.y + a[2] * b.z
}

/// |a|²
#[inline(always)]
pub(super) fn length_squared<T: Number>(a: Vector<T>) -> T {
    a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
}

/// a × b
#[inline(always)]
pub(super) fn cross<T: Number>(a: Vector<T>, b: DVec3) -> Vector<T> {
    [
        a[1] * b.z - a[2] * b.y,
        a[2] * b.x - a[0] * b.z,
        a[0] * b.y - a[1] * b.x,
    ]
}
