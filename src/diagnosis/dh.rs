//! Whether the rows of a DH table are of the convention that the table says, told by what is left of
//! the arm's streams under either.

use super::nominal::{MOST_M, MOST_RAD};
use super::{ArmDiagnosis, PoseDiagnosis};

/// A convention is the right one only where it leaves so many times less than the other.
const CLEARLY: f64 = 10.0;
/// Less than this is the same to any convention, rms m.
const SAME_M: f64 = 1e-4;

/// What is left of a stream under one convention, beyond its noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    /// Of its positions, rms m; infinite where it could not be read.
    pub m: f64,
    /// Of its rotations, rms rad; likewise.
    pub rad: f64,
}

/// What either convention makes of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhStream {
    /// Under the convention that the table says.
    pub declared: Left,
    /// How far its positions are from the arm under that, with constant frames taken off, rms m; none
    /// where nothing asked for it.
    pub declared_positions_m: Option<f64>,
    /// Under the other one; none where nothing asked for it, or positions alone rule it out.
    pub other: Option<Left>,
}

/// What either convention makes of an arm's streams.
#[derive(Clone, Debug, PartialEq)]
pub struct DhEstimate {
    /// Each stream of poses.
    pub streams: Vec<DhStream>,
    /// Faults that it takes under the convention that the table says: misreadings, joint zeros, frames,
    /// growth.
    pub declared_faults: usize,
    /// The same under the other one.
    pub other_faults: usize,
}

/// Of which convention a table is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DhTold {
    /// Of the one that it says.
    AsDeclared,
    /// Of the other one.
    Other,
    /// Either explains the streams, the other one with fewer faults, or each some of them.
    Either,
    /// Neither explains any stream.
    Neither,
}

impl Left {
    /// What a diagnosis leaves of each stream.
    pub fn of(diagnosis: &ArmDiagnosis) -> Vec<Self> {
        let is_read = diagnosis.joints.reading.is_ok();
        diagnosis.streams.iter().map(|stream| Self::of_stream(stream, is_read)).collect()
    }

    fn of_stream(stream: &PoseDiagnosis, is_read: bool) -> Self {
        match stream.reading.as_ref().and(stream.residual.as_ref()) {
            Ok(left) if is_read => Self { m: left.excess_m.value, rad: left.excess_rad.value },
            _ => Self { m: f64::INFINITY, rad: f64::INFINITY },
        }
    }

    /// Whether that is no more than a drawing leaves of a calibrated arm.
    pub fn is_explained(&self) -> bool {
        self.m <= MOST_M && self.rad <= MOST_RAD
    }
}

/// How many faults a diagnosis takes to leave no more.
pub fn faults(diagnosis: &ArmDiagnosis) -> usize {
    let of_joints = diagnosis.joints.reading.as_ref().map_or(0, |reading| {
        usize::from(reading.degrees.is_some()) + usize::from(reading.permutation.is_some())
    });
    let zeros = diagnosis.joints.offsets.iter().filter(|offset| offset.chosen).count();
    let of_stream = |stream: &PoseDiagnosis| {
        let frames = [&stream.reference, &stream.tool];
        let chosen = frames.iter().filter(|frame| frame.as_ref().is_ok_and(|one| one.chosen));
        let misread = stream.reading.as_ref().is_ok_and(|one| !one.best.is_as_logged());
        chosen.count() + usize::from(misread) + usize::from(stream.growth_chosen)
    };
    of_joints + zeros + diagnosis.streams.iter().map(of_stream).sum::<usize>()
}

impl DhStream {
    /// Whether each convention explains it, the other one where it leaves clearly less.
    fn explained(&self) -> [bool; 2] {
        [self.declared.is_explained(), self.other.is_some_and(|other| other.is_explained())]
    }

    /// Whether the other convention alone explains it.
    pub fn speaks_for_other(&self) -> bool {
        let is_clear =
            self.other.is_some_and(|other| self.declared.m > CLEARLY * other.m.max(SAME_M));
        self.explained() == [false, true] && is_clear
    }
}

impl DhEstimate {
    /// Of which convention the table is, as far as these streams tell. A stream that neither explains
    /// says nothing: it may not be of this arm.
    pub fn told(&self) -> DhTold {
        let count =
            |is: &dyn Fn(&DhStream) -> bool| self.streams.iter().filter(|one| is(one)).count();
        let for_declared = count(&|stream| stream.explained() == [true, false]);
        let for_other = count(&DhStream::speaks_for_other);
        let not_clear = count(&|stream| stream.explained() == [false, true]) - for_other;
        let by_both = count(&|stream| stream.explained() == [true, true]);
        match (for_declared, for_other, not_clear) {
            (0, 1.., _) => DhTold::Other,
            (1.., 0, 0) => DhTold::AsDeclared,
            (0, 0, 0) if by_both == 0 => DhTold::Neither,
            (0, 0, 0) if self.declared_faults <= self.other_faults => DhTold::AsDeclared,
            _ => DhTold::Either,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAR: [f64; 2] = [0.3, 0.4];
    const NEAR: [f64; 2] = [2e-5, 1e-5];
    const DRAWING: [f64; 2] = [4e-3, 4e-3];
    const UNREAD: [f64; 2] = [f64::INFINITY, f64::INFINITY];

    /// What is told of streams that leave so much under each convention, with so many faults.
    fn told(streams: &[([f64; 2], Option<[f64; 2]>)], faults: [usize; 2]) -> DhTold {
        let left = |[m, rad]: [f64; 2]| Left { m, rad };
        let streams = streams.iter().map(|&(declared, other)| DhStream {
            declared: left(declared),
            declared_positions_m: None,
            other: other.map(left),
        });
        let [declared_faults, other_faults] = faults;
        DhEstimate { streams: streams.collect(), declared_faults, other_faults }.told()
    }

    #[test]
    fn a_convention_is_told_where_only_the_other_explains() {
        assert_eq!(told(&[(FAR, Some(NEAR))], [2, 0]), DhTold::Other);
        assert_eq!(told(&[(UNREAD, Some(DRAWING))], [0, 1]), DhTold::Other);
        assert_eq!(told(&[(NEAR, None)], [1, 0]), DhTold::AsDeclared);
        assert_eq!(told(&[(NEAR, Some(NEAR))], [1, 1]), DhTold::AsDeclared);
        assert_eq!(told(&[(NEAR, Some(NEAR))], [2, 0]), DhTold::Either);
        assert_eq!(told(&[([0.02, 0.0], Some(DRAWING))], [0, 0]), DhTold::Either);
        assert_eq!(told(&[(FAR, Some(FAR))], [0, 0]), DhTold::Neither);
        assert_eq!(told(&[(FAR, None)], [0, 0]), DhTold::Neither);
    }

    #[test]
    fn a_stream_that_neither_explains_says_nothing() {
        let stranger = (UNREAD, Some(UNREAD));
        assert_eq!(told(&[stranger, (NEAR, None)], [0, 0]), DhTold::AsDeclared);
        assert_eq!(told(&[(FAR, Some(NEAR)), stranger], [0, 0]), DhTold::Other);
        assert_eq!(told(&[(FAR, Some(NEAR)), (NEAR, Some(FAR))], [0, 0]), DhTold::Either);
    }
}
