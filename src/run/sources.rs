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
    /// Whether it says the same of the same link in the same frame at the same times.
    pub fn is_copy_of(&self, other: &Self) -> bool {
        let frames = |of: &Self| {
            let ends = (of.chain.base_name().to_owned(), of.chain.tip_name().to_owned());
            (ends, of.reference_known, of.carrier.is_some())
        };
        let (own, theirs) = (&self.track, &other.track);
        frames(self) == frames(other)
            && self.columns == other.columns
            && own.t_s == theirs.t_s
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
