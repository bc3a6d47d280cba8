//! Data sources of an arm: its poses and IMUs.

use crate::diagnosis::ImuStream;
use crate::geometry::Pose;
use crate::robot::Chain;
use crate::stream::{ImuTrack, PoseTrack};

/// A pose stream of one arm.
#[derive(Clone, Debug)]
pub struct PoseSource {
    /// Index of the stream.
    pub stream: usize,
    /// Chain from the reference link to the link whose pose it is.
    pub chain: Chain,
    /// Column in the arm's joint track of each joint of `chain`.
    pub columns: Vec<usize>,
    /// The poses, in the frame of the chain's base if that is known.
    pub track: PoseTrack,
    /// Whether the stream's frame is a link or tied to one. Otherwise its pose is estimated.
    pub reference_known: bool,
    /// Whether its stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// Standard error of the stamps due to clock alignment, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether the link is named, by the caller or as the stream's child frame.
    pub tip_named: bool,
    /// Frame of the logged poses, if it moves relative to the chain's base.
    pub moving_base: Option<MovingBase>,
}

impl PoseSource {
    /// Hash key of copies: the number of poses, and the bits of the first stamp and coordinate.
    pub fn copy_key(&self) -> (usize, Option<u64>, Option<u64>) {
        let PoseTrack { t_s, xyz, .. } = &self.track;
        let first = |value: Option<f64>| value.map(f64::to_bits);
        (t_s.len(), first(t_s.first().copied()), first(xyz.first().map(|xyz| xyz[0])))
    }

    /// Whether it has the same poses of the same link in the same frame at the same times.
    pub fn is_copy_of(&self, other: &Self) -> bool {
        let (own, theirs) = (&self.track, &other.track);
        // Compares times first, because a log may have thousands of streams and each pair is compared.
        own.t_s == theirs.t_s
            && self.chain.base_name() == other.chain.base_name()
            && self.chain.tip_name() == other.chain.tip_name()
            && self.reference_known == other.reference_known
            && self.moving_base.is_some() == other.moving_base.is_some()
            && self.columns == other.columns
            && own.xyz == theirs.xyz
            && own.orientation == theirs.orientation
    }
}

/// A moving base: a frame that moves relative to an arm's base, and poses in it.
#[derive(Clone, Debug)]
pub struct MovingBase {
    /// The frame.
    pub frame: String,
    /// Times of the transforms, s from the run's origin, strictly increasing.
    pub t_s: Vec<f64>,
    /// Poses of the frame in the base.
    pub base_from_frame: Vec<Pose>,
    /// The audited link's poses in the frame, as logged.
    pub logged: PoseTrack,
    /// Time between a transform and the pose's stamp, s; positive if the transform is earlier.
    pub lag_s: f64,
    /// Whether that equals the poses' latency, and changes with it.
    pub is_on_time: bool,
}

/// An IMU on an arm.
#[derive(Clone, Debug)]
pub struct ImuSource {
    /// Index of the stream.
    pub stream: usize,
    /// Chain from the base to the link that carries it.
    pub chain: Chain,
    /// Column in the arm's joint track of each joint of `chain`.
    pub columns: Vec<usize>,
    /// The measurements.
    pub track: ImuTrack,
    /// Its pose in the link according to the log's frames, if known.
    pub link_from_imu: Option<Pose>,
    /// Whether its stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// Standard error of the stamps due to clock alignment, s; 0 on a shared clock.
    pub stamp_error_s: f64,
}

impl ImuSource {
    /// Converts it to the input of the diagnosis.
    pub fn as_stream(&self) -> ImuStream<'_> {
        ImuStream {
            track: &self.track,
            chain: &self.chain,
            columns: &self.columns,
            link_from_imu: self.link_from_imu,
            removed_ramp: None,
            stamp_error_s: self.stamp_error_s,
        }
    }
}
