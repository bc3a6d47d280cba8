//! No log makes the audit panic, however unusual its robot, joints and streams.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use super::Options;
use crate::geometry::{Pose, xyzw_from_rotation};
use crate::log::{Log, Topic};
use crate::robot::Robot;
use crate::run::{RobotSource, RunOptions};
use crate::stream::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns,
};

const START: i64 = 1_760_000_000_000_000_000;
const PERIOD: i64 = 20_000_000;
const ROWS: i64 = 120;

#[derive(Clone, Debug)]
struct Branch {
    parent: Option<Index>,
    kind: &'static str,
    mimics: Option<(Index, f64)>,
    xyz: [f64; 3],
    axis: [f64; 3],
}

#[derive(Clone, Debug)]
struct States {
    topic: &'static str,
    prefix: &'static str,
    joints: Vec<Index>,
    misspelt: Option<Index>,
    odd: f64,
    rows: i64,
}

#[derive(Clone, Debug)]
struct Poses {
    topic: &'static str,
    frame: Frame,
    child: Frame,
    follows: bool,
    orientation: Option<[f64; 4]>,
    scale: f64,
    late_rows: i64,
}

#[derive(Clone, Debug)]
enum Frame {
    Link(Index),
    Named(&'static str),
}

#[derive(Clone, Debug)]
struct AnyLog {
    branches: Vec<Branch>,
    described: bool,
    states: Vec<States>,
    poses: Vec<Poses>,
    transforms: Vec<(Index, bool)>,
    odometry: bool,
    array: Option<usize>,
    imu: bool,
    robot: Option<&'static str>,
    ends: [Option<Index>; 2],
}

fn branch() -> impl Strategy<Value = Branch> {
    let kinds = prop_oneof![
        8 => Just("revolute"),
        3 => Just("continuous"),
        3 => Just("prismatic"),
        4 => Just("fixed"),
        1 => Just("floating"),
        1 => Just("planar"),
    ];
    // Mostly chains.
    let parent = proptest::option::weighted(0.25, any::<Index>());
    let mimics = proptest::option::weighted(0.15, (any::<Index>(), -2.0..2.0));
    let length = prop_oneof![20 => -0.5..0.5, 1 => Just(1e300)];
    let axis = prop_oneof![Just([0.0, 0.0, 1.0]), Just([0.0, 1.0, 0.0]), Just([1.0, 0.0, 0.0])];
    (parent, kinds, mimics, [length.clone(), length.clone(), length], axis)
        .prop_map(|(parent, kind, mimics, xyz, axis)| Branch { parent, kind, mimics, xyz, axis })
}

fn states() -> impl Strategy<Value = States> {
    let topics = prop_oneof![
        Just("/joint_states"),
        Just("/left/joint_states"),
        Just("/right/joint_states"),
        Just("/rail/state"),
    ];
    let prefix = prop_oneof![4 => Just(""), 1 => Just("left_"), 1 => Just("x/")];
    let odd = prop_oneof![Just(0.0), Just(f64::NAN), Just(1e300), Just(f64::INFINITY), Just(57.3)];
    let rows = prop_oneof![6 => Just(ROWS), 1 => 0..12_i64];
    let misspelt = proptest::option::weighted(0.2, any::<Index>());
    (topics, prefix, vec(any::<Index>(), 0..10), misspelt, odd, rows).prop_map(
        |(topic, prefix, joints, misspelt, odd, rows)| States {
            topic,
            prefix,
            joints,
            misspelt,
            odd,
            rows,
        },
    )
}

fn frame() -> impl Strategy<Value = Frame> {
    prop_oneof![
        3 => any::<Index>().prop_map(Frame::Link),
        3 => prop_oneof![Just(""), Just("odom"), Just("mocap_world"), Just("lnk3")]
            .prop_map(Frame::Named),
    ]
}

fn poses() -> impl Strategy<Value = Poses> {
    let topics = prop_oneof![
        Just("/tcp_pose_broadcaster/pose"),
        Just("/left/tool_pose"),
        Just("/some/pose"),
        Just("/goal_pose"),
    ];
    let orientation = prop_oneof![6 => Just(None), 1 => Just(Some([0.0; 4])), 1 => Just(Some([0.0, 0.0, 0.0, 1.0]))];
    let scale = prop_oneof![5 => Just(1.0), 1 => Just(1e3), 1 => Just(0.0), 1 => Just(1e300)];
    let child = prop_oneof![2 => Just(Frame::Named("")), 1 => frame()];
    let follows = prop_oneof![4 => Just(true), 1 => Just(false)];
    (topics, frame(), child, follows, orientation, scale, 0..5_i64).prop_map(
        |(topic, frame, child, follows, orientation, scale, late_rows)| Poses {
            topic,
            frame,
            child,
            follows,
            orientation,
            scale,
            late_rows,
        },
    )
}

fn any_log() -> impl Strategy<Value = AnyLog> {
    let robot =
        prop_oneof![6 => Just(None), 1 => Just(Some("ur5e")), 1 => Just(Some("franka_fer"))];
    let ends = [0, 1].map(|_| proptest::option::weighted(0.1, any::<Index>()));
    let array = proptest::option::weighted(0.3, prop_oneof![Just(6_usize), Just(7), Just(16)]);
    let transforms = vec((any::<Index>(), any::<bool>()), 0..8);
    let of_robot = (vec(branch(), 1..11), any::<bool>(), robot, ends);
    let streams = (vec(states(), 0..4), vec(poses(), 0..3), transforms);
    (of_robot, streams, any::<bool>(), array, any::<bool>()).prop_map(
        |(
            (branches, described, robot, ends),
            (states, poses, transforms),
            odometry,
            array,
            imu,
        )| {
            AnyLog {
                branches,
                described: described || robot.is_none(),
                states,
                poses,
                transforms,
                odometry,
                array,
                imu,
                robot,
                ends,
            }
        },
    )
}

fn q_at(joint: usize, row: i64) -> f64 {
    let (t_s, joint) = (row as f64 * 1e-9 * PERIOD as f64, joint as f64);
    0.1 * joint - 0.3 + 0.5 * ((1.1 + 0.4 * joint) * t_s + joint).sin()
}

impl AnyLog {
    fn link(&self, frame: &Frame) -> String {
        match frame {
            Frame::Link(index) => format!("link{}", index.index(self.branches.len() + 1)),
            Frame::Named(name) => (*name).to_owned(),
        }
    }

    fn joint(&self, index: &Index) -> usize {
        index.index(self.branches.len())
    }

    fn parent(&self, at: usize) -> usize {
        self.branches[at].parent.map_or(at, |index| index.index(at + 1))
    }

    fn urdf(&self) -> String {
        let links: String =
            (0..=self.branches.len()).map(|link| format!("<link name=\"link{link}\"/>")).collect();
        let joint = |(at, branch): (usize, &Branch)| {
            let Branch { kind, mimics, xyz: [x, y, z], axis: [a, b, c], .. } = branch;
            let mimic = mimics.map_or(String::new(), |(of, factor)| {
                let of = of.index(self.branches.len());
                format!("<mimic joint=\"joint{of}\" multiplier=\"{factor}\"/>")
            });
            format!(
                "<joint name=\"joint{at}\" type=\"{kind}\"><parent link=\"link{}\"/>\
                 <child link=\"link{}\"/><origin xyz=\"{x} {y} {z}\"/><axis xyz=\"{a} {b} {c}\"/>\
                 <limit lower=\"-2\" upper=\"2\" effort=\"1\" velocity=\"1\"/>{mimic}</joint>",
                self.parent(at),
                at + 1
            )
        };
        let joints: String = self.branches.iter().enumerate().map(joint).collect();
        format!("<robot name=\"any\">{links}{joints}</robot>")
    }

    fn joint_columns(&self, states: &States) -> JointColumns {
        let mut columns = JointColumns::default();
        let mut known: Vec<usize> = Vec::new();
        for index in &states.joints {
            let joint = self.joint(index);
            if known.contains(&joint) {
                continue;
            }
            known.push(joint);
            let is_misspelt =
                states.misspelt.is_some_and(|index| index.index(self.branches.len()) == joint);
            let name = if is_misspelt { "jiont".to_owned() } else { format!("joint{joint}") };
            let odd = |row: i64| if row % 50 == 7 { states.odd } else { 0.0 };
            let position = (0..states.rows).map(|row| q_at(joint, row) + odd(row)).collect();
            let name = format!("{}{name}", states.prefix);
            columns.joints.push(JointColumn::from_positions(name, position));
        }
        for row in 0..states.rows {
            let stamp = START + row * PERIOD;
            columns.times.push(stamp, stamp + 100_000, stamp);
        }
        columns
    }

    fn pose_columns(&self, poses: &Poses, robot: Option<&Robot>) -> PoseColumns {
        let [frame_id, child_frame_id] = [&poses.frame, &poses.child].map(|frame| self.link(frame));
        let chain = robot.filter(|_| poses.follows).and_then(|robot| {
            let base = robot.link(&frame_id).unwrap_or(robot.root());
            let tip = robot.link(&child_frame_id).or_else(|| robot.leaf_links().last())?;
            robot.chain(base, tip).ok()
        });
        let number = |name: &String| name.trim_start_matches("joint").parse().unwrap_or(0);
        let pose_at = |row: i64| match &chain {
            Some(chain) => {
                let joints = chain.joint_names().iter();
                chain.forward(&joints.map(|name| q_at(number(name), row)).collect::<Vec<f64>>())
            }
            None => Pose::translation(q_at(1, row), q_at(2, 2 * row), 0.3),
        };
        let mut columns = PoseColumns { frame_id, child_frame_id, ..Default::default() };
        for row in 0..ROWS {
            let pose = pose_at(row - poses.late_rows);
            let stamp = START + row * PERIOD + 3_000_000;
            columns.times.push(stamp, stamp + 200_000, stamp);
            columns.xyz.push(pose.translation.vector.map(|x| x * poses.scale).into());
            let xyzw = xyzw_from_rotation(&pose.rotation);
            columns.q_xyzw.push(poses.orientation.unwrap_or(xyzw));
        }
        columns
    }

    fn topics(&self) -> Vec<Topic> {
        let urdf = self.urdf();
        let robot = Robot::from_urdf(&urdf, "any").ok();
        let mut topics = Vec::new();
        let mut add = |name: &str, type_name: &str, columns: Columns| {
            topics.push(Topic {
                name: name.to_owned(),
                type_name: type_name.to_owned(),
                encoding: "cdr".to_owned(),
                messages: ROWS as u64,
                columns: Some(columns),
                ..Topic::default()
            });
        };
        if self.described {
            let mut text = TextColumns::default();
            text.times.push(START, START, START);
            text.text.push(urdf);
            add("/robot_description", "std_msgs/msg/String", Columns::Text(text));
        }
        for (at, states) in self.states.iter().enumerate() {
            let is_first = self.states[..at].iter().all(|other| other.topic != states.topic);
            if is_first {
                let columns = Columns::Joints(self.joint_columns(states));
                add(states.topic, "sensor_msgs/msg/JointState", columns);
            }
        }
        for (at, poses) in self.poses.iter().enumerate() {
            if self.poses[..at].iter().all(|other| other.topic != poses.topic) {
                let columns = vec![self.pose_columns(poses, robot.as_ref())];
                add(poses.topic, "geometry_msgs/msg/PoseStamped", Columns::Poses(columns));
            }
        }
        let edge = |at: usize, measured: bool| {
            let of = Poses {
                topic: "/tf",
                frame: Frame::Named(""),
                child: Frame::Named(""),
                follows: true,
                orientation: None,
                scale: 1.0,
                late_rows: 0,
            };
            let mut columns = self.pose_columns(&of, robot.as_ref());
            columns.frame_id =
                if measured { "link0".to_owned() } else { format!("link{}", self.parent(at)) };
            columns.child_frame_id = format!("link{}", at + 1);
            columns
        };
        let mut transforms: Vec<PoseColumns> =
            self.transforms.iter().map(|(at, measured)| edge(self.joint(at), *measured)).collect();
        if self.odometry {
            let mut odometry = edge(0, false);
            (odometry.frame_id, odometry.child_frame_id) = ("odom".to_owned(), "link0".to_owned());
            transforms.push(odometry);
        }
        if !transforms.is_empty() {
            add("/tf", "tf2_msgs/msg/TFMessage", Columns::Transforms(transforms));
        }
        if let Some(width) = self.array {
            let mut array = ArrayColumns { width, ..Default::default() };
            for row in 0..ROWS {
                let stamp = START + row * PERIOD;
                array.times.push(0, stamp, stamp);
                array.values.extend((0..width).map(|at| q_at(at, row)));
            }
            add("/tool", "std_msgs/msg/Float64MultiArray", Columns::Array(array));
        }
        if self.imu {
            let mut imu = ImuColumns { has_orientation: true, ..Default::default() };
            for row in 0..ROWS {
                let stamp = START + row * PERIOD;
                imu.times.push(stamp, stamp, stamp);
                imu.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
                imu.gyro.push([q_at(0, row), 0.0, 0.1]);
                imu.accel.push([0.0, 0.0, 9.8]);
            }
            add("/imu/data", "sensor_msgs/msg/Imu", Columns::Imu(imu));
        }
        topics
    }

    fn audit(&self) {
        let log = Log { topics: self.topics(), messages: ROWS as u64, ..Log::default() };
        let end = |index: usize| {
            let link = self.ends[index].as_ref()?;
            Some(self.link(&Frame::Link(*link)))
        };
        let options = Options {
            run: RunOptions {
                robots: self.robot.into_iter().map(RobotSource::from).collect(),
                base: end(0),
                tip: end(1),
                ..RunOptions::default()
            },
            ..Options::default()
        };
        if let Ok(audited) = crate::audit_read(log, &options) {
            let report = audited.with_figures().report;
            assert!(report.checks.iter().all(|row| !row.code.is_empty()));
        }
    }
}

#[test]
fn no_log_makes_the_audit_panic() {
    let config = Config { failure_persistence: None, ..Config::with_cases(48) };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let mut runner = TestRunner::new_with_rng(config, rng);
    let outcome = runner.run(&any_log(), |log| {
        log.audit();
        Ok(())
    });
    if let Err(error) = outcome {
        panic!("{error}");
    }
}
