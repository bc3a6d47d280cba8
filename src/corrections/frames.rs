use std::path::Path;

use super::corrections_file::rounded;
use crate::geometry::{Convention, Pose, xyz_of, xyzw_from_rotation};

#[derive(Clone, Debug)]
pub(super) struct FixedFrame {
    /// Finding with its subject.
    pub finding: String,
    /// How to use it.
    pub comment: String,
    pub parent: String,
    pub child: String,
    /// `parent_from_child`.
    pub pose: Pose,
}

impl FixedFrame {
    pub fn command(&self) -> String {
        let [x, y, z] = xyz_of(&self.pose).map(number);
        let [qx, qy, qz, qw] = xyzw_from_rotation(&self.pose.rotation).map(number);
        let Self { parent, child, .. } = self;
        format!(
            "ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {qx} --qy {qy} \
             --qz {qz} --qw {qw} --frame-id {} --child-frame-id {}",
            shell_quoted(parent),
            shell_quoted(child)
        )
    }

    pub fn joint(&self) -> String {
        let [x, y, z] = xyz_of(&self.pose).map(number);
        let [roll, pitch, yaw] = Convention::RPY.numbers(&self.pose.rotation).map(number);
        let [name, parent, child] = [&format!("{}_joint", self.child), &self.parent, &self.child]
            .map(|name| escape_xml(name));
        format!(
            "<joint name=\"{name}\" type=\"fixed\">\n  <parent link=\"{parent}\"/>\n  \
             <child link=\"{child}\"/>\n  <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>\n\
             </joint>"
        )
    }
}

/// Rounded to 1e-9.
fn number(value: f64) -> String {
    rounded(value).to_string()
}

fn shell_quoted(name: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    match !name.is_empty() && name.chars().all(is_plain) {
        true => name.to_owned(),
        false => format!("'{}'", name.replace('\'', r"'\''")),
    }
}

pub(super) fn escape_xml(text: &str) -> String {
    let escaped = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    escaped.replace('"', "&quot;").replace("--", "- -")
}

/// Name for files and frames.
pub(super) fn slug(text: &str) -> String {
    let plain = text.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    plain.collect::<String>().trim_matches('_').to_owned()
}

/// Name of its source, if any.
pub(super) fn model_stem(source: &Path) -> String {
    let stem = slug(source.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default());
    if stem.is_empty() || stem == "corrections" { "robot".to_owned() } else { stem }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{pose, rotation_from_rpy};

    #[test]
    fn a_frame_becomes_a_command_and_a_joint() {
        let frame = FixedFrame {
            finding: String::new(),
            comment: String::new(),
            parent: "base link".to_owned(),
            child: "it's".to_owned(),
            pose: pose([0.1, 0.0, -0.2], rotation_from_rpy([0.0, 0.0, 0.5])),
        };
        let command = frame.command();
        assert!(command.contains("--x 0.1 --y 0 --z -0.2 --qx 0 --qy 0 "), "{command}");
        assert!(
            command.ends_with(r"--frame-id 'base link' --child-frame-id 'it'\''s'"),
            "{command}"
        );
        let joint = frame.joint();
        assert!(joint.contains(r#"<origin xyz="0.1 0 -0.2" rpy="0 0 0.5"/>"#), "{joint}");
    }
}
