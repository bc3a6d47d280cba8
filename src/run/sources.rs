//! The streams of an arm: its poses and its IMUs.

use crate::diagnosis::ImuStream;
use crate::geometry::Pose;
use crate::robot::Chain;
use crate::stream::{ImuTrack, PoseTrack};

/// A stream of poses of one arm.
#[derive(Clone, Debug)]
pub struct PoseSource {
    /// Index of the stream.
    pub stream: usize,
    /// The chain from the reference link to the link whose pose it is.
    pub chain: Chain,
    /// For each joint of `chain`, its column in the arm's joint track.
    pub columns: Vec<usize>,
    /// The poses, in the frame of the chain's base where that is known.
    pub track: PoseTrack,
    /// Whether the stream's frame is a link, or tied to one; if not, its pose is to be estimated.
    pub reference_known: bool,
    /// Whether its stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// Standard error that aligning a foreign clock left in the stamps, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether the link was named: by the caller, or as the stream's child frame.
    pub tip_named: bool,
    /// The frame that the poses were logged in, where it moves against the chain's base.
    pub carrier: Option<Carrier>,
}

impl PoseSource {
    /// What copies share: the number of poses, and the bits of the first stamp and coordinate.
    pub fn copy_key(&self) -> (usize, Option<u64>, Option<u64>) {
        let PoseTrack { t_s, xyz, .. } = &self.track;
        let first = |value: Option<f64>| value.map(f64::to_bits);
        (t_s.len(), first(t_s.first().copied()), first(xyz.first().map(|xyz| xyz[0])))
    }

    /// Whether it says the same of the same link in the same frame at the same times.
    pub fn is_copy_of(&self, other: &Self) -> bool {
        let (own, theirs) = (&self.track, &other.track);
        // Times differ first: a log may have thousands of streams, each compared with each.
        own.t_s == theirs.t_s
            && self.chain.base_name() == other.chain.base_name()
            && self.chain.tip_name() == other.chain.tip_name()
            && self.reference_known == other.reference_known
            && self.carrier.is_some() == other.carrier.is_some()
            && self.columns == other.columns
            && own.xyz == theirs.xyz
            && own.orientation == theirs.orientation
    }
}

/// A frame that moves against an arm's base, and poses that are in it.
#[derive(Clone, Debug)]
pub struct Carrier {
    /// The frame.
    pub frame: String,
    /// Times of the transforms, s from the run's origin, strictly increasing.
    pub t_s: Vec<f64>,
    /// The frame in the base.
    pub base_from_frame: Vec<Pose>,
    /// The poses as logged: of the link that is audited, in the frame.
    pub logged: PoseTrack,
    /// How long before a pose's stamp the transforms are taken, s.
    pub lag_s: f64,
    /// Whether that is the poses' own latency, so that it changes with it.
    pub is_on_time: bool,
}

/// An IMU that an arm carries.
#[derive(Clone, Debug)]
pub struct ImuSource {
    /// Index of the stream.
    pub stream: usize,
    /// The chain from the base to the link that carries it.
    pub chain: Chain,
    /// For each joint of `chain`, its column in the arm's joint track.
    pub columns: Vec<usize>,
    /// The readings.
    pub track: ImuTrack,
    /// Its pose in the carrying link by the log's frames, where they say.
    pub link_from_imu: Option<Pose>,
    /// Whether its stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// Standard error that aligning a foreign clock left in the stamps, s; 0 on a shared clock.
    pub stamp_error_s: f64,
}

impl ImuSource {
    /// It, as the diagnosis takes it.
    pub fn as_stream(&self) -> ImuStream<'_> {
        ImuStream {
            track: &self.track,
            chain: &self.chain,
            columns: &self.columns,
            link_from_imu: self.link_from_imu,
            taken_off: None,
            stamp_error_s: self.stamp_error_s,
        }
    }
}
