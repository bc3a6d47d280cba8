//! Whether the rows of a DH table are of the convention that the table says, told by what is left of
//! the arm's streams under either.

use super::nominal::{MOST_M, MOST_RAD};
use super::{ArmDiagnosis, PoseDiagnosis};

/// A convention is the right one only where it leaves so many times less than the other.
const CLEARLY: f64 = 10.0;
/// Less than this is the same to any convention, rms m.
const SAME_M: f64 = 1e-4;

/// What is left of an arm's streams under one convention, and what it takes to leave no more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    /// Of the stream that is explained worst, beyond its noise, rms m; infinite where a stream could
    /// not be read.
    pub m: f64,
    /// Likewise of its rotations, rms rad.
    pub rad: f64,
    /// Faults that it takes: misreadings, joint zeros, frames, growth.
    pub faults: usize,
}

/// What either convention makes of an arm's streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhEstimate {
    /// Under the convention that the table says.
    pub declared: Left,
    /// Under the other one; none where its positions alone rule it out, or nothing asked for it.
    pub other: Option<Left>,
}

/// Of which convention a table is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DhTold {
    /// Of the one that it says.
    AsDeclared,
    /// Of the other one.
    Other,
    /// Either explains the streams, the other one with fewer faults.
    Either,
    /// Neither explains the streams.
    Neither,
}

impl Left {
    /// What a diagnosis leaves.
    pub fn of(diagnosis: &ArmDiagnosis) -> Self {
        let unread = f64::INFINITY;
        let streams = || diagnosis.streams.iter();
        let most = |left: fn(&PoseDiagnosis) -> Option<f64>| {
            streams().map(|stream| left(stream).unwrap_or(unread)).fold(0.0, f64::max)
        };
        let of_joints = match &diagnosis.joints {
            Ok(reading) => {
                usize::from(reading.degrees.is_some()) + usize::from(reading.permutation.is_some())
            }
            Err(_) => return Self { m: unread, rad: unread, faults: 0 },
        };
        let zeros = diagnosis.offsets.iter().filter(|offset| offset.chosen).count();
        let of_stream = |stream: &PoseDiagnosis| {
            let chosen = [&stream.reference, &stream.tool]
                .map(|frame| usize::from(frame.as_ref().is_ok_and(|frame| frame.chosen)));
            let misread = stream.reading.as_ref().is_ok_and(|one| !one.best.is_as_logged());
            chosen[0] + chosen[1] + usize::from(misread) + usize::from(stream.growth_chosen)
        };
        if diagnosis.streams.is_empty() {
            return Self { m: unread, rad: unread, faults: 0 };
        }
        Self {
            m: most(|stream| Some(left_of(stream)?.0)),
            rad: most(|stream| Some(left_of(stream)?.1)),
            faults: of_joints + zeros + streams().map(of_stream).sum::<usize>(),
        }
    }

    /// Whether that is no more than a drawing leaves of a calibrated arm.
    pub fn is_explained(&self) -> bool {
        self.m <= MOST_M && self.rad <= MOST_RAD
    }
}

/// What is left of a stream beyond its noise, rms m and rad.
fn left_of(stream: &PoseDiagnosis) -> Option<(f64, f64)> {
    let residual = stream.reading.as_ref().and(stream.residual.as_ref()).ok()?;
    Some((residual.excess_m.value, residual.excess_rad.value))
}

impl DhEstimate {
    /// Of which convention the table is, as far as these streams tell.
    pub fn told(&self) -> DhTold {
        let Self { declared, other } = self;
        match (declared.is_explained(), other.filter(Left::is_explained)) {
            (true, None) => DhTold::AsDeclared,
            (true, Some(other)) if declared.faults <= other.faults => DhTold::AsDeclared,
            (_, Some(other)) => match declared.m > CLEARLY * other.m.max(SAME_M) {
                true if !declared.is_explained() => DhTold::Other,
                _ => DhTold::Either,
            },
            (false, None) => DhTold::Neither,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(declared: [f64; 2], other: Option<[f64; 2]>, faults: [usize; 2]) -> DhTold {
        let left = |[m, rad]: [f64; 2], faults| Left { m, rad, faults };
        let other = other.map(|other| left(other, faults[1]));
        DhEstimate { declared: left(declared, faults[0]), other }.told()
    }

    #[test]
    fn a_convention_is_told_where_only_the_other_explains() {
        const FAR: [f64; 2] = [0.3, 0.4];
        const NEAR: [f64; 2] = [2e-5, 1e-5];
        const DRAWING: [f64; 2] = [4e-3, 4e-3];
        const UNREAD: [f64; 2] = [f64::INFINITY, f64::INFINITY];
        assert_eq!(told(FAR, Some(NEAR), [2, 0]), DhTold::Other);
        assert_eq!(told(UNREAD, Some(DRAWING), [0, 1]), DhTold::Other);
        assert_eq!(told(NEAR, None, [1, 0]), DhTold::AsDeclared);
        assert_eq!(told(NEAR, Some(NEAR), [1, 1]), DhTold::AsDeclared);
        assert_eq!(told(NEAR, Some(NEAR), [2, 0]), DhTold::Either);
        assert_eq!(told([0.02, 0.0], Some(DRAWING), [0, 0]), DhTold::Either);
        assert_eq!(told(FAR, Some(FAR), [0, 0]), DhTold::Neither);
        assert_eq!(told(FAR, None, [0, 0]), DhTold::Neither);
    }
}
