//! A column of values that may never change: the transform of a fixed joint, a missing velocity.

use std::borrow::Cow;
use std::ops::{Index, IndexMut};

/// Values of a column. While all are bitwise equal, it stores one of them and their number.
#[derive(Clone, Debug, Default)]
pub struct Column<T> {
    /// Number of equal values; 0 once `values` holds all.
    equal: usize,
    /// All values, or the first of equal ones.
    values: Vec<T>,
}

/// Bitwise comparison: NaN equals itself, and −0 differs from 0.
pub trait BitwiseEq: Copy {
    /// Whether both have the same bits.
    fn is_bitwise_equal(&self, other: &Self) -> bool;
}

impl BitwiseEq for f64 {
    fn is_bitwise_equal(&self, other: &Self) -> bool {
        self.to_bits() == other.to_bits()
    }
}

impl BitwiseEq for u32 {
    fn is_bitwise_equal(&self, other: &Self) -> bool {
        self == other
    }
}

impl<const N: usize> BitwiseEq for [f64; N] {
    fn is_bitwise_equal(&self, other: &Self) -> bool {
        self.iter().zip(other).all(|(a, b)| a.is_bitwise_equal(b))
    }
}

impl<T: BitwiseEq> Column<T> {
    /// `len` equal values.
    pub fn constant(value: T, len: usize) -> Self {
        let mut column = Self { equal: 0, values: Vec::new() };
        column.extend_constant(value, len);
        column
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.equal.max(self.values.len())
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Value of `row`, if it exists.
    pub fn get(&self, row: usize) -> Option<&T> {
        if row < self.equal { self.values.first() } else { self.values.get(row) }
    }

    /// First value.
    pub fn first(&self) -> Option<&T> {
        self.values.first()
    }

    /// Values in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &T> + Clone {
        (0..self.len()).map(|row| &self[row])
    }

    /// All values; allocates if they are equal.
    pub fn to_slice(&self) -> Cow<'_, [T]> {
        match self.values.first() {
            Some(first) if self.equal > 1 => vec![*first; self.equal].into(),
            _ => self.values.as_slice().into(),
        }
    }

    /// Appends a value.
    pub fn push(&mut self, value: T) {
        match self.equal == 0 && !self.values.is_empty() {
            true => self.values.push(value),
            false => self.extend_constant(value, 1),
        }
    }

    /// Appends `count` equal values.
    pub fn extend_constant(&mut self, value: T, count: usize) {
        if count == 0 {
            return;
        }
        match self.values.first() {
            None => {
                self.values.push(value);
                self.equal = count;
            }
            Some(first) if self.equal > 0 && first.is_bitwise_equal(&value) => self.equal += count,
            Some(_) => {
                let values = self.stored();
                values.resize(values.len() + count, value);
            }
        }
    }

    /// Appends all values of `later`.
    pub fn extend_from(&mut self, later: &Self) {
        match later.values.first() {
            Some(first) if later.equal > 0 => self.extend_constant(*first, later.equal),
            Some(_) => self.stored().extend_from_slice(&later.values),
            None => {}
        }
    }

    /// Keeps the given rows, in their order.
    pub fn select(&mut self, rows: &[usize]) {
        *self = rows.iter().map(|&row| self[row]).collect();
    }

    /// Replaces each value.
    pub fn update(&mut self, of: impl Fn(T) -> T) {
        self.values.iter_mut().for_each(|value| *value = of(*value));
    }

    /// Stores each value.
    fn stored(&mut self) -> &mut Vec<T> {
        if let Some(first) = self.values.first().copied() {
            self.values.resize(self.len(), first);
        }
        self.equal = 0;
        &mut self.values
    }
}

impl<T: BitwiseEq> Index<usize> for Column<T> {
    type Output = T;

    fn index(&self, row: usize) -> &T {
        &self.values[if row < self.equal { 0 } else { row }]
    }
}

impl<T: BitwiseEq> IndexMut<usize> for Column<T> {
    fn index_mut(&mut self, row: usize) -> &mut T {
        &mut self.stored()[row]
    }
}

impl<T: BitwiseEq> FromIterator<T> for Column<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut column = Self { equal: 0, values: Vec::new() };
        values.into_iter().for_each(|value| column.push(value));
        column
    }
}

impl<T: BitwiseEq> From<Vec<T>> for Column<T> {
    fn from(values: Vec<T>) -> Self {
        match values.first() {
            Some(first) if values.iter().all(|value| value.is_bitwise_equal(first)) => {
                Self::constant(*first, values.len())
            }
            _ => Self { equal: 0, values },
        }
    }
}

impl<T: BitwiseEq + PartialEq> PartialEq for Column<T> {
    fn eq(&self, other: &Self) -> bool {
        self.len() == other.len() && self.iter().eq(other.iter())
    }
}

impl<T: BitwiseEq + PartialEq, const N: usize> PartialEq<[T; N]> for Column<T> {
    fn eq(&self, other: &[T; N]) -> bool {
        self.iter().eq(other)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Few different values, so that runs of equal ones occur.
    fn values() -> impl Strategy<Value = Vec<f64>> {
        let value = prop_oneof![Just(0.0), Just(-0.0), Just(f64::NAN), Just(1.5)];
        prop_oneof![
            prop::collection::vec(value.clone(), 0..6),
            (value, 0_usize..6).prop_map(|(value, len)| vec![value; len])
        ]
    }

    fn bits(values: impl IntoIterator<Item = f64>) -> Vec<u64> {
        values.into_iter().map(f64::to_bits).collect()
    }

    proptest! {
        #[test]
        fn a_column_holds_what_a_vector_would(parts in prop::collection::vec(values(), 0..4)) {
            let all: Vec<f64> = parts.concat();
            let mut joined = Column::default();
            parts.iter().for_each(|part| joined.extend_from(&Column::from(part.clone())));
            let pushed: Column<f64> = all.iter().copied().collect();
            for column in [joined, pushed, Column::from(all.clone())] {
                prop_assert_eq!(column.len(), all.len());
                prop_assert_eq!(column.is_empty(), all.is_empty());
                prop_assert_eq!(bits(column.iter().copied()), bits(all.clone()));
                prop_assert_eq!(bits(column.to_slice().iter().copied()), bits(all.clone()));
                prop_assert_eq!(column.get(all.len()), None);
                let order: Vec<usize> = (0..all.len()).rev().step_by(2).collect();
                let mut selected = column.clone();
                selected.select(&order);
                prop_assert_eq!(bits(selected.iter().copied()), bits(order.iter().map(|&row| all[row])));
                if let Some(last) = all.len().checked_sub(1) {
                    let (mut changed, mut expected) = (column, all.clone());
                    (changed[last], expected[last]) = (7.0, 7.0);
                    prop_assert_eq!(bits(changed.iter().copied()), bits(expected));
                }
            }
        }
    }

    #[test]
    fn equal_values_are_stored_once() {
        let column: Column<[f64; 2]> = std::iter::repeat_n([0.5, f64::NAN], 1000).collect();
        assert_eq!((column.len(), column.values.len()), (1000, 1));
    }
}
