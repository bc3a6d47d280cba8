//! Poses and IMUs of an arm.

use std::hash::{DefaultHasher, Hash, Hasher};

use crate::diagnosis::{ImuStream, LastTurn, Measured, MovingFrame, PoseStream};
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
    /// Column in the joint track of each joint of `chain`.
    pub columns: Vec<usize>,
    /// Poses, in the chain's base frame if known.
    pub track: PoseTrack,
    /// Whether the frame is a link or tied to one; else its pose is estimated.
    pub reference_known: bool,
    /// Whether its stamps are the joints'.
    pub stamps_copied: bool,
    /// Standard error of clock alignment, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether the caller or the child frame names the link.
    pub tip_named: bool,
    /// Frame of the logged poses, if it moves in the chain's base.
    pub moving_base: Option<MovingBase>,
    /// What a turn about the last joint's axis belongs to.
    pub last_turn: LastTurn,
}

impl PoseSource {
    /// As diagnosis input, with the error of its own stamps.
    pub fn as_stream(&self) -> PoseStream<'_> {
        PoseStream {
            track: &self.track,
            chain: &self.chain,
            columns: &self.columns,
            reference_known: self.reference_known,
            stamp_error_s: self.stamp_error_s,
            stamps_copied: self.stamps_copied,
            removed_ramp: None,
            last_turn: self.last_turn,
            moving_frame: self.moving_base.as_ref().map(|base| &base.motion),
        }
    }

    /// Transforms poses in a moving frame to the base again, with this latency.
    pub(crate) fn retransform(&mut self, latency_s: f64) {
        let Some(base) = &mut self.moving_base else { return };
        let motion = MovingFrame { lag_s: latency_s, ..base.motion.clone() };
        let transformed = motion.in_base(&base.logged);
        if transformed.t_s.len() > 1 {
            (base.motion, self.track) = (motion, transformed);
        }
    }

    /// Hash of times and positions, equal for copies.
    pub fn content_hash(&self) -> u64 {
        let PoseTrack { t_s, xyz, .. } = &self.track;
        let mut hasher = DefaultHasher::new();
        for number in t_s.iter().chain(xyz.iter().flatten()) {
            // Zeros of both signs are equal.
            (number + 0.0).to_bits().hash(&mut hasher);
        }
        hasher.finish()
    }

    /// Whether both have the same poses of the same link at the same times.
    pub fn is_copy_of(&self, other: &Self) -> bool {
        let (own, theirs) = (&self.track, &other.track);
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

/// A frame that moves in an arm's base, and poses in it.
#[derive(Clone, Debug)]
pub struct MovingBase {
    /// The frame.
    pub frame: String,
    /// Its motion.
    pub motion: MovingFrame,
    /// Latency of its transforms, which `motion` is corrected for.
    pub latency_s: Option<Measured>,
    /// The audited link's poses in the frame, as logged.
    pub logged: PoseTrack,
}

/// An IMU on an arm.
#[derive(Clone, Debug)]
pub struct ImuSource {
    /// Index of the stream.
    pub stream: usize,
    /// Chain from the base to the carrying link.
    pub chain: Chain,
    /// Column in the joint track of each joint of `chain`.
    pub columns: Vec<usize>,
    /// The measurements.
    pub track: ImuTrack,
    /// Its pose in the link by the log's frames.
    pub link_from_imu: Option<Pose>,
    /// Whether its stamps are the joints'.
    pub stamps_copied: bool,
    /// Standard error of clock alignment, s; 0 on a shared clock.
    pub stamp_error_s: f64,
}

impl ImuSource {
    /// Converts to diagnosis input.
    pub fn as_stream(&self) -> ImuStream<'_> {
        ImuStream {
            track: &self.track,
            chain: &self.chain,
            columns: &self.columns,
            link_from_imu: self.link_from_imu,
            removed_ramp: None,
            stamp_error_s: self.stamp_error_s,
            fk_error_rad: 0.0,
        }
    }
}
