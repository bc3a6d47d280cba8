//! Builds a log stream by stream.

use super::*;

pub(super) const START: i64 = 1_760_000_000_000_000_000;

pub(super) const ROWS: i64 = 400;

pub(super) const PERIOD: i64 = 8_000_000;

pub(super) const TRANSPORT: i64 = 300_000;

pub(super) struct Recording {
    pub(super) robot: Robot,
    pub(super) topics: Vec<(String, Columns)>,
}

pub(super) fn q_at(nanos: i64) -> [f64; 6] {
    let t_s = (nanos - START) as f64 * 1e-9;
    [0, 1, 2, 3, 4, 5].map(|joint| {
        let joint = f64::from(joint);
        0.2 * joint - 0.5 + 0.4 * ((1.0 + 0.3 * joint) * t_s + joint).sin()
    })
}

pub(super) fn stamps() -> impl Iterator<Item = i64> {
    (0..ROWS).map(|row| START + row * PERIOD)
}

pub(super) fn poses(
    frame_id: &str,
    child_frame_id: &str,
    pose_at: impl Fn(i64) -> Pose,
) -> PoseColumns {
    let mut columns = PoseColumns {
        frame_id: frame_id.to_owned(),
        child_frame_id: child_frame_id.to_owned(),
        ..Default::default()
    };
    for nanos in stamps() {
        let pose = pose_at(nanos);
        columns.times.push(nanos, nanos + TRANSPORT, nanos);
        columns.xyz.push(xyz_of(&pose));
        columns.q_xyzw.push(xyzw_from_rotation(&pose.rotation));
    }
    columns
}

pub(super) fn some_pose() -> Pose {
    pose([0.3, -0.2, 0.9], rotation_from_rpy([0.4, -0.7, 2.0]))
}

impl Recording {
    pub(super) fn new() -> Self {
        let robot = catalogue::find("ur5e").unwrap().clone();
        let mut recording = Self { robot, topics: Vec::new() };
        let mut joints = recording.joint_states();
        joints.joints.reverse();
        recording.add("/joint_states", Columns::Joints(joints));
        recording
    }

    pub(super) fn add(&mut self, topic: &str, columns: Columns) {
        self.topics.push((topic.to_owned(), columns));
    }

    pub(super) fn joint_states(&self) -> JointColumns {
        let mut columns = JointColumns::default();
        let chain = self.chain("base", "tool0");
        for name in chain.joint_names() {
            columns.joints.push(JointColumn { name: name.clone(), ..Default::default() });
        }
        for nanos in stamps() {
            columns.times.push(nanos, nanos + TRANSPORT, nanos);
            for (joint, q) in columns.joints.iter_mut().zip(q_at(nanos)) {
                joint.position.push(q);
                joint.velocity.push(f64::NAN);
            }
        }
        columns
    }

    pub(super) fn chain(&self, base: &str, tip: &str) -> crate::robot::Chain {
        let link = |name| self.robot.link(name).unwrap();
        self.robot.chain(link(base), link(tip)).unwrap()
    }

    pub(super) fn fk(&self, base: &str, tip: &str) -> impl Fn(i64) -> Pose + use<> {
        let chain = self.chain(base, tip);
        move |nanos| chain.forward(&q_at(nanos))
    }

    pub(super) fn add_tf(&mut self, prefix: &str, with_fixed: bool) {
        let (mut fixed, mut moving) = (Vec::new(), Vec::new());
        for joint in self.robot.joints() {
            let [parent, child] =
                [joint.parent, joint.child].map(|link| self.robot.link_name(link));
            let frames = [parent, child].map(|link| format!("{prefix}{link}"));
            if joint.kind == JointKind::Fixed {
                fixed.push(poses(&frames[0], &frames[1], |_| joint.parent_from_joint));
            } else {
                let chain = self.chain(parent, child);
                let names = self.chain("base", "tool0").joint_names().to_vec();
                let column = names.iter().position(|name| *name == joint.name).unwrap();
                moving.push(poses(&frames[0], &frames[1], |nanos| {
                    chain.forward(&[q_at(nanos)[column]])
                }));
            }
        }
        self.add("/tf", Columns::Transforms(moving));
        if with_fixed {
            self.add("/tf_static", Columns::Transforms(fixed));
        }
    }

    pub(super) fn add_pose(&mut self, topic: &str, poses: PoseColumns) {
        self.add(topic, Columns::Poses(vec![poses]));
    }

    pub(super) fn log(self) -> Log {
        let topic = |(name, columns): (String, Columns)| Topic {
            name,
            encoding: "cdr".to_owned(),
            messages: ROWS as u64,
            columns: Some(columns),
            ..Topic::default()
        };
        Log { topics: self.topics.into_iter().map(topic).collect(), ..Log::default() }
    }

    pub(super) fn run(self) -> Run {
        self.run_with(RunOptions::default())
    }

    pub(super) fn run_with(self, mut options: RunOptions) -> Run {
        options.robots = vec!["ur5e".into()];
        Run::assemble(self.log(), &options).unwrap()
    }
}
