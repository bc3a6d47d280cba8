//! Measured origins of an arm's joints.
//!
//! For any arm: the JSON of `poseaudit calibrate`, with the name and origin of each joint (xyz in m; roll,
//! pitch, yaw in rad, as in a URDF's `<origin>`).
//!
//! For Universal Robots: the YAML that the driver's `ur_calibration` extracts from the controller.
//! `ur_description` uses the six numbers of each block as the origin of a joint (`urdf/ur_macro.xacro` of
//! UniversalRobots/Universal_Robots_ROS2_Description). Blocks are named after the joint's child link.

use std::fmt::Write as _;
use std::path::Path;

use serde::Deserialize;
use serde_saphyr::{Location, Spanned};

use super::error::{Problem, RobotError};
use super::joint::MAX_MAGNITUDE;
use super::model::Robot;
use super::without_bom;
use crate::geometry::{Convention, Pose, angle_between, pose, rotation_from_rpy, xyz_of};

/// Joint names of every UR arm, base to tip.
pub const UR_JOINTS: [&str; 6] = [
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
    "wrist_3_joint",
];

/// In the order of [`UR_JOINTS`].
const BLOCKS: [&str; 6] = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];

/// Larger changes of an origin indicate another arm, m and rad.
const MAX_ORIGIN_CHANGE_M: f64 = 0.05;
const MAX_ORIGIN_CHANGE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Measured origins of an arm's joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Name of the source.
    pub source: String,
    /// In the controller, such as `calib_2327696229793275135`.
    pub hash: Option<String>,
    /// Name, `parent_from_joint` and line of each joint.
    origins: Vec<(String, Pose, usize)>,
}

#[derive(Deserialize)]
struct Written {
    schema: String,
    joints: Vec<Spanned<WrittenJoint>>,
}

#[derive(Deserialize)]
struct WrittenJoint {
    name: String,
    xyz: [f64; 3],
    rpy: [f64; 3],
}

/// Schema of the JSON.
pub const CALIBRATION_SCHEMA: &str = "poseaudit.calibration/1";

#[derive(Deserialize)]
struct File {
    kinematics: Blocks,
}

#[derive(Deserialize)]
struct Blocks {
    shoulder: Spanned<Block>,
    upper_arm: Spanned<Block>,
    forearm: Spanned<Block>,
    wrist_1: Spanned<Block>,
    wrist_2: Spanned<Block>,
    wrist_3: Spanned<Block>,
    hash: Option<String>,
}

#[derive(Deserialize)]
struct Block {
    x: f64,
    y: f64,
    z: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Calibration::from_text`], or if it is not text.
    pub fn from_file(path: &Path) -> Result<Self, RobotError> {
        let file = path.display().to_string();
        let text = super::text_of(path)
            .map_err(|e| RobotError::new(&file, None, Problem::UnreadableCalibration(e)))?;
        Self::from_text(&text, &file)
    }

    /// Parses YAML or JSON; `source` is its name in errors.
    ///
    /// # Errors
    /// If the layout is wrong or a number is missing or invalid; with the line.
    pub fn from_text(text: &str, source: &str) -> Result<Self, RobotError> {
        let refuse = |error: serde_saphyr::Error| {
            let what = error.without_snippet().to_string().lines().collect::<Vec<_>>().join(", ");
            RobotError::new(source, error.location().map(line), Problem::Calibration(what))
        };
        if without_bom(text).trim_start().starts_with('{') {
            // JSON is a subset of YAML.
            let written = serde_saphyr::from_str(without_bom(text)).map_err(refuse)?;
            return Self::of_written(written, source);
        }
        let file: File = serde_saphyr::from_str(without_bom(text)).map_err(refuse)?;
        let Blocks { shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3, hash } =
            file.kinematics;
        let blocks = [shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3];
        for (block, joint) in blocks.iter().zip(UR_JOINTS) {
            if !block.value.is_finite() {
                let element = format!("the block of joint '{joint}'");
                let line = Some(line(block.referenced));
                return Err(RobotError::new(source, line, Problem::NotFinite { element }));
            }
        }
        let origins = blocks
            .iter()
            .zip(UR_JOINTS)
            .map(|(block, joint)| (joint.to_owned(), block.value.origin(), line(block.referenced)));
        Ok(Self { source: source.to_owned(), hash, origins: origins.collect() })
    }

    fn of_written(written: Written, source: &str) -> Result<Self, RobotError> {
        let refuse = |at, problem| Err(RobotError::new(source, at, problem));
        if written.schema != CALIBRATION_SCHEMA || written.joints.is_empty() {
            let what = format!("its schema is '{}', not '{CALIBRATION_SCHEMA}'", written.schema);
            return refuse(None, Problem::Calibration(what));
        }
        let mut origins = Vec::with_capacity(written.joints.len());
        for joint in written.joints {
            let at = line(joint.referenced);
            let WrittenJoint { name, xyz, rpy } = joint.value;
            if xyz.iter().chain(&rpy).any(|number| number.is_nan() || number.abs() > MAX_MAGNITUDE)
            {
                let element = format!("joint '{name}'");
                return refuse(Some(at), Problem::NotFinite { element });
            }
            origins.push((name, pose(xyz, rotation_from_rpy(rpy)), at));
        }
        Ok(Self { source: source.to_owned(), hash: None, origins })
    }

    /// `arm.yaml (calib_23…)`.
    pub fn label(&self) -> String {
        match &self.hash {
            Some(hash) => format!("{} ({hash})", self.source),
            None => self.source.clone(),
        }
    }
}

fn line(location: Location) -> usize {
    usize::try_from(location.line()).unwrap_or(usize::MAX)
}

impl Block {
    fn is_finite(&self) -> bool {
        let Self { x, y, z, roll, pitch, yaw } = self;
        [x, y, z, roll, pitch, yaw].into_iter().all(|number| number.abs() <= MAX_MAGNITUDE)
    }

    fn origin(&self) -> Pose {
        let Self { x, y, z, roll, pitch, yaw } = *self;
        pose([x, y, z], rotation_from_rpy([roll, pitch, yaw]))
    }
}

impl Robot {
    /// Prefixes of the arms in this robot that have all joints of `calibration`.
    pub fn prefixes_of(&self, calibration: &Calibration) -> Vec<String> {
        let Some((first, ..)) = calibration.origins.first() else { return Vec::new() };
        let firsts =
            self.joints().iter().filter_map(|joint| joint.name.strip_suffix(first.as_str()));
        let has_all = |prefix: &&str| {
            let mut joints = calibration.origins.iter();
            joints.all(|(joint, ..)| self.joint(&format!("{prefix}{joint}")).is_some())
        };
        firsts.filter(has_all).map(str::to_owned).collect()
    }

    /// YAML of `ur_calibration` for the UR joints with `prefix`; `None` if there are none.
    pub fn ur_calibration(&self, prefix: &str, hash: &str) -> Option<String> {
        let mut text = "kinematics:\n".to_owned();
        for (block, joint) in BLOCKS.iter().zip(UR_JOINTS) {
            let origin = self.joint(&format!("{prefix}{joint}"))?.parent_from_joint;
            let [x, y, z] = xyz_of(&origin);
            let [roll, pitch, yaw] = Convention::RPY.numbers(&origin.rotation);
            let _ = writeln!(text, "  {block}:");
            let numbers =
                [("x", x), ("y", y), ("z", z), ("roll", roll), ("pitch", pitch), ("yaw", yaw)];
            for (name, number) in numbers {
                let _ = writeln!(text, "    {name}: {number}");
            }
        }
        let _ = writeln!(text, "  hash: {hash}");
        Some(text)
    }

    /// Copy in which the joints with `prefix` have the origins of `calibration`.
    ///
    /// # Errors
    /// If a joint is missing, or an origin would move by more than 5 cm or 5°: another arm, or a model with
    /// other frames than `ur_description`.
    pub fn calibrated(&self, prefix: &str, calibration: &Calibration) -> Result<Robot, RobotError> {
        let mut robot = self.clone();
        for (joint, origin, line) in &calibration.origins {
            let refuse = |problem| Err(RobotError::new(&calibration.source, Some(*line), problem));
            let joint = format!("{prefix}{joint}");
            let Some(nominal) = self.joint(&joint) else {
                return refuse(Problem::NoSuchJoint { robot: self.name.clone(), joint });
            };
            let nominal = nominal.parent_from_joint;
            let moved_m = (origin.translation.vector - nominal.translation.vector).norm();
            let turned_rad = angle_between(&origin.rotation, &nominal.rotation);
            if moved_m > MAX_ORIGIN_CHANGE_M || turned_rad > MAX_ORIGIN_CHANGE_RAD {
                let (millimetres, degrees) = (1e3 * moved_m, turned_rad.to_degrees());
                let robot = self.name.clone();
                return refuse(Problem::AnotherArm { robot, joint, millimetres, degrees });
            }
            robot.move_joint(&joint, *origin);
        }
        Ok(robot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::catalogue;

    /// `config/ur5e/default_kinematics.yaml` of Universal_Robots_ROS2_Description.
    const NOMINAL: &str = "\
kinematics:
  shoulder: {x: 0, y: 0, z: 0.1625, roll: -0, pitch: 0, yaw: 0}
  upper_arm: {x: 0, y: 0, z: 0, roll: 1.570796327, pitch: 0, yaw: 0}
  forearm: {x: -0.425, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}
  wrist_1: {x: -0.3922, y: 0, z: 0.1333, roll: 0, pitch: 0, yaw: 0}
  wrist_2: {x: 0, y: -0.0997, z: -2.044881182297852e-11, roll: 1.570796327, pitch: 0, yaw: 0}
  wrist_3:
    x: 0
    y: 0.0996
    z: -2.042830148012698e-11
    roll: 1.570796326589793
    pitch: 3.141592653589793
    yaw: 3.141592653589793
  hash: calib_12788084448423163542
";

    fn ur5e() -> Robot {
        catalogue::find("ur5e").unwrap().clone()
    }

    fn error(text: &str) -> String {
        Calibration::from_text(text, "arm.yaml").unwrap_err().to_string()
    }

    fn refusal(robot: &Robot, prefix: &str, text: &str) -> String {
        let calibration = Calibration::from_text(text, "arm.yaml").unwrap();
        robot.calibrated(prefix, &calibration).unwrap_err().to_string()
    }

    fn base_from_tool(robot: &Robot, q: &[f64]) -> Pose {
        let [base, tool] = ["base_link", "tool0"].map(|link| robot.link(link).unwrap());
        robot.chain(base, tool).unwrap().forward(q)
    }

    #[test]
    fn a_calibration_with_nominal_numbers_changes_nothing() {
        let calibration = Calibration::from_text(NOMINAL, "arm.yaml").unwrap();
        assert_eq!(calibration.label(), "arm.yaml (calib_12788084448423163542)");
        let calibrated = ur5e().calibrated("", &calibration).unwrap();
        for q in [[0.3, -1.2, 0.9, -0.4, 1.1, 2.0], [-2.0, -0.3, 1.7, 0.2, -1.4, 0.6]] {
            let off = base_from_tool(&ur5e(), &q).inverse() * base_from_tool(&calibrated, &q);
            assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-12);
        }
    }

    #[test]
    fn a_calibration_block_is_the_origin_of_the_links_joint() {
        let text = NOMINAL.replace("forearm: {x: -0.425", "forearm: {x: -0.426");
        let calibration = Calibration::from_text(&text, "arm.yaml").unwrap();
        let calibrated = ur5e().calibrated("", &calibration).unwrap();
        // At zero, the forearm extends along −x of the base.
        let zero = [0.0; 6];
        let tool = |robot: &Robot| base_from_tool(robot, &zero).translation.vector;
        let moved = tool(&calibrated) - tool(&ur5e());
        assert!((moved.x.abs() - 1e-3).abs() < 1e-12 && moved.y.abs() < 1e-12, "{moved}");
    }

    #[test]
    fn angles_near_a_half_turn_are_the_same_rotation() {
        let text = NOMINAL.replace(
            "z: 0.1333, roll: 0, pitch: 0, yaw: 0",
            "z: 0.1333, roll: 3.1405, pitch: -3.1411, yaw: 3.1415",
        );
        let calibration = Calibration::from_text(&text, "arm.yaml").unwrap();
        assert!(ur5e().calibrated("", &calibration).is_ok());
    }

    #[test]
    fn calibration_errors_name_their_line() {
        let lines: Vec<&str> = NOMINAL.lines().collect();
        let without_wrist_3 = lines[..6].join("\n");
        assert!(error(&without_wrist_3).contains("wrist_3"), "{}", error(&without_wrist_3));
        let words = NOMINAL.replace("z: 0.1333", "z: about 13 cm");
        assert!(error(&words).starts_with("arm.yaml:5: "), "{}", error(&words));
        let nan = NOMINAL.replace("y: 0.0996", "y: .nan");
        assert!(error(&nan).starts_with("arm.yaml:8: "), "{}", error(&nan));
        for text in ["", "kinematics:", "a: [", "<robot/>", "just words", "\u{0}\u{1}"] {
            let error = error(text);
            assert!(
                error.contains("not a calibration of a UR") && !error.contains('\n'),
                "{error}"
            );
        }
    }

    #[test]
    fn the_calibration_of_another_arm_is_refused() {
        let ur10e = catalogue::find("ur10e").unwrap();
        let text = refusal(ur10e, "", NOMINAL);
        assert!(text.starts_with("arm.yaml:4: ") && text.contains("elbow_joint"), "{text}");
        let panda = catalogue::find("panda").unwrap();
        assert!(
            panda.prefixes_of(&Calibration::from_text(NOMINAL, "arm.yaml").unwrap()).is_empty()
        );
        assert!(refusal(panda, "", NOMINAL).contains("has no joint 'shoulder_pan_joint'"));
    }

    #[test]
    fn a_prefix_selects_the_arm() {
        let left = ur5e().with_prefix_replaced("", "left_").unwrap();
        let calibration = Calibration::from_text(NOMINAL, "arm.yaml").unwrap();
        assert_eq!(left.prefixes_of(&calibration), ["left_"]);
        assert!(left.calibrated("left_", &calibration).is_ok());
        assert!(left.calibrated("right_", &calibration).is_err());
    }

    #[test]
    fn a_written_calibration_is_read_back() {
        let robot = ur5e();
        let text = robot.ur_calibration("", "calib_7").unwrap();
        let calibration = Calibration::from_text(&text, "own.yaml").unwrap();
        assert_eq!(calibration.hash.as_deref(), Some("calib_7"));
        let back = robot.calibrated("", &calibration).unwrap();
        let q = [0.3, -1.2, 0.9, -0.4, 1.1, 2.0];
        let off = base_from_tool(&robot, &q).inverse() * base_from_tool(&back, &q);
        assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-12);
        assert!(catalogue::find("panda").unwrap().ur_calibration("", "calib_7").is_none());
    }

    #[test]
    fn the_joints_of_a_written_calibration_are_used() {
        let json = r#"{"schema": "poseaudit.calibration/1", "arm": "ur5e", "joints": [
            {"name": "elbow_joint", "parent": "a", "xyz": [-0.4251, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}]}"#;
        let calibration = Calibration::from_text(json, "calibration.json").unwrap();
        assert_eq!(ur5e().prefixes_of(&calibration), [""]);
        let origin = ur5e()
            .calibrated("", &calibration)
            .unwrap()
            .joint("elbow_joint")
            .unwrap()
            .parent_from_joint;
        assert!((origin.translation.vector.x + 0.4251).abs() < 1e-15);
        let other = json.replace("poseaudit.calibration/1", "poseaudit.report/1");
        assert!(error(&other).contains("poseaudit.report/1"), "{}", error(&other));
        let far = json.replace("-0.4251", "-4.251");
        let far = Calibration::from_text(&far, "calibration.json").unwrap();
        assert!(ur5e().calibrated("", &far).is_err());
    }
}
