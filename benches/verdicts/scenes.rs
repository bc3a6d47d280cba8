//! Scenes: the structure of a cell's log without faults. Faults are planted on top.

use std::f64::consts::{FRAC_PI_2, PI};

use poseaudit::geometry::{Convention, pose, rotation_from_rotvec};
use poseaudit::robot::{Robot, catalogue};
use poseaudit::synth::{self, JointWrapping, MovingBase, Scenario, SecondPublisher, Timing};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::fault_kinds::{FaultKind, choose, unit_vector};

/// An arm, the links of its poses, and its park configuration.
pub struct Arm {
    pub name: &'static str,
    pub base: &'static str,
    pub tip: &'static str,
    pub home: &'static [f64],
}

/// Structure of a cell's log.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Scene {
    /// One arm with all topics at the root.
    Plain,
    /// All topics in a namespace.
    Namespaced,
    /// Names of joints and links with a prefix.
    Prefixed,
    /// Two arms with the same joint names in two namespaces, without /tf.
    TwoNamespaces,
    /// Two arms with prefixes on one /tf.
    TwoPrefixes,
    /// A rail that carries the arm's base, with its joint on a separate topic; poses in the arm's base.
    RailApart,
    /// A waist that carries the arm's base, in the same joint states; poses in the arm's base.
    Waist,
    /// Continuous joints wrapped to one turn, across the seam.
    Folded,
    /// A moving base: poses in odom, with that edge in /tf.
    Driven,
    /// Two programs publish the same transforms.
    TwoPublishers,
    /// Encoders with a finite resolution.
    Encoders,
    /// Poses in the world frame of a tracker.
    TrackerWorld,
    /// Poses of a marker on the tool, in the world frame of a tracker.
    Marker,
    /// A hand leads the arm.
    Led,
    /// Tool poses as unnamed numbers in a vendor's encoding.
    BareNumbers,
    /// No description: the arm must be identified from the catalogue.
    Catalogue,
    /// Neither description nor /tf nor IMU: the arm must be identified from the poses.
    CatalogueByPoses,
    /// An active TCP, without a named tip.
    ActiveTcp,
}

impl Scene {
    pub const ALL: [Scene; 18] = [
        Scene::Plain,
        Scene::Namespaced,
        Scene::Prefixed,
        Scene::TwoNamespaces,
        Scene::TwoPrefixes,
        Scene::RailApart,
        Scene::Waist,
        Scene::Folded,
        Scene::Driven,
        Scene::TwoPublishers,
        Scene::Encoders,
        Scene::TrackerWorld,
        Scene::Marker,
        Scene::Led,
        Scene::BareNumbers,
        Scene::Catalogue,
        Scene::CatalogueByPoses,
        Scene::ActiveTcp,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Scene::Plain => "plain",
            Scene::Namespaced => "namespaced",
            Scene::Prefixed => "prefixed",
            Scene::TwoNamespaces => "two-namespaces",
            Scene::TwoPrefixes => "two-prefixes",
            Scene::RailApart => "rail-apart",
            Scene::Waist => "waist",
            Scene::Folded => "folded",
            Scene::Driven => "driven",
            Scene::TwoPublishers => "two-publishers",
            Scene::Encoders => "encoders",
            Scene::TrackerWorld => "tracker-world",
            Scene::Marker => "marker",
            Scene::Led => "led",
            Scene::BareNumbers => "bare-numbers",
            Scene::Catalogue => "catalogue",
            Scene::CatalogueByPoses => "catalogue-by-poses",
            Scene::ActiveTcp => "active-tcp",
        }
    }

    /// Findings that are right in this scene whatever is planted: an unaudited stream, or the delay of an
    /// arm behind its leader.
    pub fn allows(self, code: &str) -> bool {
        matches!((self, code), (Scene::Led, "FRM007" | "LAT004"))
    }

    /// Whether it has a single arm on its own base, so that any motion is plausible.
    pub fn is_of_one_arm(self) -> bool {
        use Scene::*;
        matches!(
            self,
            Plain
                | Namespaced
                | Prefixed
                | TwoPublishers
                | Encoders
                | TrackerWorld
                | Marker
                | ActiveTcp
        )
    }

    /// Arms of this scene; empty if any is possible.
    pub fn arms(self) -> &'static [&'static str] {
        match self {
            Scene::RailApart => &["rail"],
            Scene::Waist => &["waist"],
            Scene::Folded => &["ur5e", "kinova_gen3_7dof"],
            // Arms that names do not distinguish.
            Scene::CatalogueByPoses => &["ur3", "ur3e", "ur5e", "ur10e", "kuka_lbr_iiwa14"],
            Scene::Catalogue => {
                &["ur5e", "ur10e", "franka_fer", "kuka_lbr_iiwa14", "kinova_gen3_7dof"]
            }
            // Catalogue names with a replaceable prefix.
            Scene::Prefixed | Scene::TwoPrefixes => &["ur5e", "ur3e"],
            _ => &["ur5e", "franka_fer", "kuka_lbr_iiwa14", "so101", "ur3e", "kinova_gen3_7dof"],
        }
    }

    /// Whether a kind of fault can be planted: not if its stream is missing, or the scene hides it or turns
    /// it into another fault.
    pub fn supports(self, kind: FaultKind) -> bool {
        use FaultKind::*;
        let is_imu_fault = matches!(
            kind,
            ImuLate
                | YawDrift
                | YawJump
                | Mount
                | GyroBias
                | ImuMisread
                | ImuWxyz
                | ImuTransposed
                | GyroDegrees
                | AccelInG
                | BiasSteps
                | BiasWarmsUp
                | ImuSlips
                | YawWarmsUp
                | YawByHeading
        );
        let is_tf_fault = matches!(kind, TfLate | SecondTfDiffers | JointsLate);
        let is_frame_fault = matches!(kind, Reference | BaseTurned | OwnFrame | Axes | BaseChanges);
        // Faults of an upright arm at the root, with its own commands and target.
        let needs_plain_arm = matches!(kind, Play | Sag | Shake | CommandLate | TagSize);
        match self {
            Scene::Plain | Scene::Namespaced | Scene::Prefixed | Scene::Encoders => true,
            _ if needs_plain_arm => {
                matches!(self, Scene::TrackerWorld | Scene::Marker | Scene::TwoPublishers)
                    && kind != TagSize
            }
            Scene::TwoNamespaces => !is_tf_fault && !is_imu_fault && kind != WrongArm,
            Scene::TwoPrefixes => !is_imu_fault && kind != WrongArm,
            Scene::RailApart | Scene::Waist => {
                !is_imu_fault && !matches!(kind, JointsLate | JointOrder | JointDegrees | WrongArm)
            }
            Scene::Folded => !matches!(kind, JointDegrees | Geared | HeldJoints | ScaleChanges),
            // A different encoding in a moving frame is a different pose in the arm's frame.
            Scene::Driven => {
                let is_pose_fault = matches!(
                    kind,
                    Inverted
                        | Transposed
                        | Growth
                        | Misread
                        | Wxyz
                        | Millimetres
                        | LengthUnit
                        | ToolChanges
                        | Alternates
                        | GrowthChanges
                        | OrderChanges
                        | UnitChanges
                );
                !is_imu_fault
                    && !is_frame_fault
                    && !is_pose_fault
                    && !matches!(kind, JointsLate | WrongArm)
            }
            Scene::TwoPublishers => !is_tf_fault && kind != WrongArm,
            // A constant tool offset is part of the marker's position.
            Scene::Marker if matches!(kind, Tool | Transposed | Axes) => false,
            // Position of the world frame and length of the tool are unknown.
            Scene::TrackerWorld | Scene::Marker => {
                (!is_frame_fault || kind == BaseChanges)
                    && !matches!(kind, Growth | GrowthChanges | WrongArm | Inverted)
            }
            Scene::Led => kind != WrongArm,
            Scene::BareNumbers => is_imu_fault || matches!(kind, Zero | TfLate),
            // Only data from the arm itself identify it.
            Scene::Catalogue => !matches!(kind, WrongArm | JointDegrees),
            Scene::CatalogueByPoses => matches!(kind, PoseLate | Misread | Wxyz | Skew | StuckPose),
            // Rotated axes without mirroring are equivalent to rotated frames.
            Scene::ActiveTcp => !matches!(kind, Tool | WrongArm | Axes),
        }
    }

    /// Whether the call names the tip.
    pub fn names_tip(self) -> bool {
        !matches!(
            self,
            Scene::ActiveTcp
                | Scene::Marker
                | Scene::CatalogueByPoses
                | Scene::TwoNamespaces
                | Scene::TwoPrefixes
        )
    }

    /// Builds the run, and returns the other arm's run if there are two.
    pub fn apply(self, run: &mut Scenario, r: &mut Pcg64) -> Option<Scenario> {
        match self {
            Scene::Plain => {}
            Scene::Namespaced => {
                run.namespace = (*choose(r, &["/left", "/cell1/arm", "/ur"])).to_owned()
            }
            Scene::Prefixed => {
                let prefixes = ["left_", "robot1_", "ur/"];
                add_prefix(run, prefixes[r.random_range(0..prefixes.len())]);
            }
            Scene::TwoNamespaces => {
                run.tf.timing.rate_hz = 0.0;
                run.tf.has_static = false;
                run.imu.timing.rate_hz = 0.0;
                let mut other = Scenario { seed: r.random(), ..run.clone() };
                (run.namespace, other.namespace) = ("/left".to_owned(), "/right".to_owned());
                return Some(other);
            }
            Scene::TwoPrefixes => {
                run.imu.timing.rate_hz = 0.0;
                let mut other = Scenario { seed: r.random(), ..run.clone() };
                add_prefix(run, "left_");
                add_prefix(&mut other, "right_");
                (run.namespace, other.namespace) = ("/left".to_owned(), "/right".to_owned());
                return Some(other);
            }
            Scene::RailApart => {
                start_joint_states_at(run, "rail_base");
                run.joints.separate_topic = Some((vec![0], "/rail/joint_states".to_owned()));
            }
            Scene::Waist => start_joint_states_at(run, "waist_base"),
            Scene::Folded => {
                run.joints.wrapping =
                    Some(*choose(r, &[JointWrapping::PlusMinusPi, JointWrapping::ZeroToTwoPi]));
                let seam =
                    if run.joints.wrapping == Some(JointWrapping::PlusMinusPi) { PI } else { 0.0 };
                let last_joint = run.home.len() - 1;
                run.home[last_joint] = seam + r.random_range(-0.3..0.3);
            }
            Scene::Driven => {
                run.imu.timing.rate_hz = 0.0;
                let edge = Timing::every(*choose(r, &[30.0, 50.0]), 0.0061);
                let frame_id = "odom".to_owned();
                run.pose.frame_id = frame_id.clone();
                run.moving_base = Some(MovingBase {
                    frame_id,
                    reach_m: 1.5,
                    turn_rad: 0.8,
                    transform_timing: edge,
                });
            }
            Scene::TwoPublishers => {
                let mut timing = run.tf.timing.clone();
                timing.rate_hz = *choose(r, &[timing.rate_hz, 30.0, 100.0]);
                timing.phase_s += 0.0037;
                run.tf.second = Some(SecondPublisher { timing, offset_joint: None });
            }
            Scene::Encoders => {
                run.joints.resolution = 2.0 * PI / *choose(r, &[4096.0, 16384.0, 65536.0]);
            }
            Scene::TrackerWorld | Scene::Marker => {
                if self == Scene::Marker {
                    let turn = rotation_from_rotvec(r.random_range(0.0..PI) * unit_vector(r));
                    let arm_m = r.random_range(0.03..0.12);
                    run.pose.tip_from_stream = pose((arm_m * unit_vector(r)).into(), turn);
                }
                let world = choose(r, &["mocap_world", "vive/world", "optitrack", "lab/world"]);
                run.pose.frame_id = (*world).to_owned();
                let turn = rotation_from_rotvec(r.random_range(0.2..3.0) * unit_vector(r));
                run.pose.reference_from_stream = pose((1.5 * unit_vector(r)).into(), turn);
            }
            Scene::Led => {
                run.leader.timing.rate_hz = *choose(r, &[60.0, 90.0, 120.0]);
                run.leader.lead_s = r.random_range(0.05..0.3);
                let words = [("/hand/pose", "hand_world"), ("/tracker/left", "vive/world")];
                let (topic, frame_id) = *choose(r, &words);
                run.leader.topic = topic.to_owned();
                run.leader.frame_id = frame_id.to_owned();
            }
            Scene::BareNumbers => {
                let vendor_encodings = [
                    (Convention::RotVec, 1.0, false),
                    ("euler:ZYX".parse().unwrap_or(Convention::RPY), 1e3, true),
                    (Convention::RPY, 1e3, true),
                    (Convention::RPY, 1.0, false),
                ];
                let (convention, times, degrees) = *choose(r, &vendor_encodings);
                run.pose.number_convention = Some(convention);
                (run.pose.position_factor, run.pose.has_numbers_in_degrees) = (times, degrees);
            }
            Scene::Catalogue => run.has_description = false,
            Scene::CatalogueByPoses => {
                run.has_description = false;
                run.tf.timing.rate_hz = 0.0;
                run.tf.has_static = false;
                run.imu.timing.rate_hz = 0.0;
            }
            Scene::ActiveTcp => {
                let [x, y] = [0, 1].map(|_| r.random_range(-0.02..0.02));
                let at = [x, y, r.random_range(0.05..0.25)];
                run.pose.tip_from_stream = pose(at, rotation_from_rotvec(0.1 * unit_vector(r)));
            }
        }
        None
    }
}

/// Adds `prefix` to the names of joints and links.
fn add_prefix(run: &mut Scenario, prefix: &str) {
    run.robot = run.robot.with_prefix_replaced("", prefix).expect("names that were unique stay so");
    for name in [&mut run.base, &mut run.tip, &mut run.pose.frame_id] {
        *name = format!("{prefix}{name}");
    }
}

/// Starts the joint states at `root`, and the poses at the arm's own base.
fn start_joint_states_at(run: &mut Scenario, root: &str) {
    run.root = Some(root.to_owned());
    run.base = "base_link".to_owned();
    run.pose.frame_id = run.base.clone();
    run.imu.timing.rate_hz = 0.0;
}

/// Robot of an arm: from the catalogue, or a UR5e on a rail or a waist.
pub fn robot_of(arm: &str) -> Robot {
    let ur5e_on_joint = |name: &str, kind: &str, axis: &str, limit: f64| {
        let ur5e = synth::urdf_text(catalogue::find("ur5e").expect("an arm of the catalogue"));
        let joint = format!(
            "  <link name=\"{name}_base\"/>\n  <joint name=\"{name}_joint\" type=\"{kind}\">\n    \
             <parent link=\"{name}_base\"/>\n    <child link=\"base_link\"/>\n    \
             <origin xyz=\"0.1 0 0.4\" rpy=\"0 0 0.3\"/>\n    <axis xyz=\"{axis}\"/>\n    \
             <limit effort=\"0\" lower=\"-{limit}\" upper=\"{limit}\" velocity=\"1\"/>\n  </joint>\n\
             </robot>"
        );
        let named = format!("robot name=\"{name}\"");
        let text = ur5e.replace("</robot>", &joint).replace("robot name=\"ur5e\"", &named);
        Robot::from_urdf(&text, "bench").expect("the arm with a joint above it is a valid model")
    };
    match arm {
        "rail" => ur5e_on_joint("rail", "prismatic", "1 0 0", 1.0),
        "waist" => ur5e_on_joint("waist", "revolute", "0 0 1", 2.0),
        _ => catalogue::find(arm).expect("an arm of the catalogue").clone(),
    }
}

/// Arms: name, base, tip, and park configuration.
pub const ARMS: [Arm; 11] = {
    const UR: &[f64] = &[0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
    const ABOVE_UR: &[f64] = &[0.0, 0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
    [
        Arm { name: "ur5e", base: "base", tip: "tool0", home: UR },
        Arm { name: "ur3", base: "base", tip: "tool0", home: UR },
        Arm { name: "ur3e", base: "base", tip: "tool0", home: UR },
        Arm { name: "ur10e", base: "base", tip: "tool0", home: UR },
        Arm {
            name: "franka_fer",
            base: "fer_link0",
            tip: "fer_link8",
            home: &[0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8],
        },
        Arm {
            name: "kuka_lbr_iiwa14",
            base: "lbr_link_0",
            tip: "lbr_link_ee",
            home: &[0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0],
        },
        Arm {
            name: "kinova_gen3_7dof",
            base: "base_link",
            tip: "end_effector_link",
            home: &[0.0, 0.4, 0.0, 1.4, 0.0, -0.9, 0.0],
        },
        Arm { name: "so101", base: "base_link", tip: "gripper_frame_link", home: &[0.0; 5] },
        Arm { name: "rail", base: "rail_base", tip: "tool0", home: ABOVE_UR },
        Arm { name: "waist", base: "waist_base", tip: "tool0", home: ABOVE_UR },
        Arm { name: "ur5", base: "base", tip: "tool0", home: UR },
    ]
};

/// A catalogue arm with the same joint names, which may be confused with it.
pub fn confusable_arm(arm: &str) -> Option<&'static str> {
    Some(match arm {
        "ur3" => "ur3e",
        "ur3e" => "ur3",
        "ur5e" => "ur5",
        "ur5" => "ur5e",
        "ur10e" => "ur10",
        "kuka_lbr_iiwa14" => "kuka_lbr_iiwa7",
        _ => return None,
    })
}
