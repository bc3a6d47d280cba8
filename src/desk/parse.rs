//! Parses pasted poses: bare numbers, UR literals, controller text, URDF origins, ROS messages.

use serde_json::Value;

use crate::geometry::{AngleUnit, Convention, LengthScale, RotationEncoding, Units, vendors};

use super::encoding::KnownEncoding;
use super::error::DeskError;
use super::labelled_numbers::{bracketed_groups, parse_labelled};
use crate::robot::xml_document;

/// Numbers of a pose, with the encoding shown by the text.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseText {
    /// In order: 6, 7, 12 or 16, or 3, 4 or 9 for a rotation alone.
    pub numbers: Vec<f64>,
    /// Form and units, as far as shown.
    pub encoding: KnownEncoding,
    /// Kind of text.
    pub kind: &'static str,
    /// Reference frame, if given.
    pub parent: Option<String>,
    /// Frame whose pose is given, if named.
    pub child: Option<String>,
}

/// Parses `text` and recognises its kind.
///
/// # Errors
/// If it is not a pose.
pub fn parse_pose(text: &str) -> Result<PoseText, DeskError> {
    let text = without_key(text.trim());
    if text.contains("xyz=") || text.contains("rpy=") || text.starts_with('<') {
        return parse_urdf_origin(text);
    }
    if text.contains("Translation:") && text.contains("Quaternion") {
        return parse_tf2_echo(text);
    }
    if ["position", "orientation", "translation", "rotation"].iter().any(|key| text.contains(key)) {
        return parse_message(text);
    }
    if let Some(pose_text) = parse_ur_literal(text)? {
        return Ok(pose_text);
    }
    if let Some(pose_text) = parse_nested(text) {
        return Ok(pose_text);
    }
    if let Some(pose_text) = parse_labelled(text)? {
        return Ok(pose_text);
    }
    let numbers = parse_bare_numbers(text)?;
    match numbers.len() {
        3 | 4 | 6 | 7 | 9 | 12 | 16 => {
            Ok(PoseText::new(numbers, KnownEncoding::default(), "numbers"))
        }
        count => Err(DeskError::Count { count }),
    }
}

/// `p[…]`, alone or in URScript.
fn parse_ur_literal(text: &str) -> Result<Option<PoseText>, DeskError> {
    let begins = |(at, _): &(usize, &str)| {
        !text[..*at].ends_with(|before: char| before.is_alphanumeric() || before == '_')
    };
    let literals: Vec<usize> =
        text.match_indices("p[").filter(begins).map(|(at, _)| at + "p[".len()).collect();
    let from = match literals.as_slice() {
        [] => return Ok(None),
        [from] => *from,
        several => return Err(DeskError::Several(several.len())),
    };
    let inner = text[from..].split(']').next().unwrap_or_default();
    let numbers = parse_bare_numbers(inner)?;
    let form = RotationEncoding::Three(Convention::RotVec);
    match numbers.len() {
        6 => Ok(Some(PoseText::new(numbers, si_encoding(form), "UR pose p[…]"))),
        count => Err(DeskError::CountOfForm { form, count }),
    }
}

/// RAPID robtarget, `[[x,y,z],[q1,q2,q3,q4],[…],[…]]`, or VAL3 point, `{{x,y,z,rx,ry,rz},{…}}`.
fn parse_nested(text: &str) -> Option<PoseText> {
    let of_maker = |numbers: Vec<f64>, vendor: &str, kind: &'static str| {
        let vendor = vendors::find(vendor)?;
        let known = KnownEncoding { rotation: Some(vendor.coding), units: vendor.units };
        Some(PoseText::new(numbers, known, kind))
    };
    let square = bracketed_groups(text, ['[', ']']);
    let is_rapid = text.contains("robtarget") || text.contains("pose") || square.len() >= 3;
    if let [xyz, wxyz, ..] = square.as_slice()
        && (xyz.len(), wxyz.len()) == (3, 4)
        && is_rapid
    {
        return of_maker([xyz.as_slice(), wxyz].concat(), "abb", "RAPID robtarget or pose");
    }
    match bracketed_groups(text, ['{', '}']).as_slice() {
        [six, _, ..] if six.len() == 6 => of_maker(six.clone(), "staubli", "VAL3 point"),
        _ => None,
    }
}

fn si_encoding(form: RotationEncoding) -> KnownEncoding {
    let units = Units { length: Some(LengthScale::METRE), angle: Some(AngleUnit::Radian) };
    KnownEncoding { rotation: Some(form), units }
}

impl PoseText {
    pub(super) fn new(numbers: Vec<f64>, known: KnownEncoding, kind: &'static str) -> Self {
        Self { numbers, encoding: known, kind, parent: None, child: None }
    }
}

/// Separated by spaces, commas, semicolons, brackets, degree signs, or the dashes of a YAML list.
fn parse_bare_numbers(text: &str) -> Result<Vec<f64>, DeskError> {
    let text = without_calls(&text.replace('−', "-"));
    let is_between = |c: char| c.is_whitespace() || ",;[](){}|°".contains(c);
    let mut words = Vec::new();
    for line in text.lines() {
        let mut of_line = line.split(is_between).filter(|word| !word.is_empty()).peekable();
        while of_line.next_if_eq(&"-").is_some() {}
        words.extend(of_line);
    }
    let words = words.into_iter();
    let numbers = words.map(|word| {
        let number: Option<f64> = word.parse().ok();
        let number = number.filter(|number| number.is_finite());
        number.ok_or_else(|| DeskError::Word { word: word.to_owned() })
    });
    numbers.collect()
}

/// The value of a single YAML entry such as `home_pose: […]`.
fn without_key(text: &str) -> &str {
    let is_key = |key: &str| {
        key.contains("pose") && key.chars().all(|c| c.is_alphanumeric() || "_-/".contains(c))
    };
    match text.split_once(':') {
        Some((key, value)) if is_key(key) && !value.contains([':', '=']) => value.trim(),
        _ => text,
    }
}

/// Drops what numpy and torch print around numbers: `np.array(…, dtype=float32)`, `np.float64(…)`,
/// `tensor(…)`.
fn without_calls(text: &str) -> String {
    let is_of_name = |c: char| c.is_alphanumeric() || "_.".contains(c);
    let mut kept = String::with_capacity(text.len());
    for part in text.split_inclusive('(') {
        match part.strip_suffix('(') {
            Some(before) => {
                let name = before.trim_end_matches(is_of_name).len();
                let is_call = before[name..].starts_with(char::is_alphabetic);
                kept += if is_call { &before[..name] } else { before };
                kept.push('(');
            }
            None => kept += part,
        }
    }
    let mut parts: Vec<&str> = kept.split(',').collect();
    parts.retain(|part| !["dtype=", "device="].iter().any(|it| part.trim().starts_with(it)));
    parts.join(",")
}

/// `<origin xyz="…" rpy="…"/>`, or its attributes.
fn parse_urdf_origin(text: &str) -> Result<PoseText, DeskError> {
    let attributes = text.trim_start_matches("<origin").trim_end_matches('>').trim_end_matches('/');
    let element = match text.starts_with('<') && !text.starts_with("<origin") {
        true => text.to_owned(),
        false => format!("<origin {attributes}/>"),
    };
    let xml = xml_document(&element).map_err(|(_, problem)| DeskError::Xml(problem.to_string()))?;
    let mut origins = xml.descendants().filter(|node| node.has_tag_name("origin"));
    let origin = origins.next().ok_or(DeskError::Missing("origin"))?;
    if let more @ 1.. = origins.count() {
        return Err(DeskError::Several(1 + more));
    }
    let mut numbers = Vec::new();
    for name in ["xyz", "rpy"] {
        // Missing attributes are zero in URDF.
        let found = parse_bare_numbers(origin.attribute(name).unwrap_or("0 0 0"))?;
        if found.len() != 3 {
            return Err(DeskError::Count { count: found.len() });
        }
        numbers.extend(found);
    }
    Ok(PoseText::new(numbers, si_encoding(RotationEncoding::Three(Convention::RPY)), "URDF origin"))
}

fn parse_tf2_echo(text: &str) -> Result<PoseText, DeskError> {
    if let more @ 2.. = text.matches("Translation:").count() {
        return Err(DeskError::Several(more));
    }
    let listed = |key: &'static str, count: usize| {
        let rest = text.split_once(key).map(|(_, rest)| rest);
        let list = rest.and_then(|rest| rest.split_once('[')?.1.split_once(']'));
        let numbers = parse_bare_numbers(list.ok_or(DeskError::Missing("brackets"))?.0)?;
        match numbers.len() {
            found if found == count => Ok(numbers),
            count => Err(DeskError::Count { count }),
        }
    };
    let numbers = [listed("Translation:", 3)?, listed("Quaternion", 4)?].concat();
    Ok(PoseText::new(numbers, si_encoding(RotationEncoding::Xyzw), "tf2_echo"))
}

/// Message from `ros2 topic echo` or JSON.
fn parse_message(text: &str) -> Result<PoseText, DeskError> {
    let document = text.split("\n---").next().unwrap_or(text).trim_start_matches("---");
    let message: Value = serde_saphyr::from_str(document)
        .map_err(|error| DeskError::Yaml(first_line(&error.to_string())))?;
    let mut found = Vec::new();
    find_poses(&message, &mut found);
    match found.as_slice() {
        [holder] => pose_of_message(holder, &message),
        [] => Err(DeskError::Missing("position and orientation")),
        several => Err(DeskError::Several(several.len())),
    }
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_owned()
}

/// Maps that contain a pose.
fn find_poses<'a>(value: &'a Value, found: &mut Vec<&'a Value>) {
    match value {
        Value::Object(map) => {
            if ["orientation", "rotation"].iter().any(|key| map.contains_key(*key)) {
                found.push(value);
            } else {
                map.values().for_each(|value| find_poses(value, found));
            }
        }
        Value::Array(items) => items.iter().for_each(|value| find_poses(value, found)),
        _ => {}
    }
}

fn pose_of_message(holder: &Value, message: &Value) -> Result<PoseText, DeskError> {
    if let Some(lists) = numbers_of_lists(holder) {
        return Ok(PoseText::new(lists, KnownEncoding::default(), "YAML lists"));
    }
    let components = |keys: [&str; 2], axes: &[&str], what: &'static str| {
        let of = keys.iter().find_map(|key| holder.get(key)).ok_or(DeskError::Missing(what))?;
        let numbers: Option<Vec<f64>> =
            axes.iter().map(|axis| of.get(axis)?.as_f64().filter(|c| c.is_finite())).collect();
        numbers.ok_or(DeskError::Missing(what))
    };
    let mut numbers =
        components(["position", "translation"], &["x", "y", "z"], "x, y, z of a position")?;
    numbers.extend(components(
        ["orientation", "rotation"],
        &["x", "y", "z", "w"],
        "x, y, z, w of an orientation",
    )?);
    let mut pose_text = PoseText::new(numbers, si_encoding(RotationEncoding::Xyzw), "ROS message");
    pose_text.parent = find_name(message, "frame_id");
    pose_text.child = find_name(message, "child_frame_id");
    Ok(pose_text)
}

/// Position and rotation given as lists, such as `translation: [x, y, z]`; their order stays unknown.
fn numbers_of_lists(holder: &Value) -> Option<Vec<f64>> {
    let list = |keys: [&str; 2]| keys.iter().find_map(|key| holder.get(key)?.as_array());
    let mut numbers = Vec::new();
    for list in [list(["position", "translation"])?, list(["orientation", "rotation"])?] {
        let flat = list.iter().flat_map(|item| match item.as_array() {
            Some(row) => row.as_slice(),
            None => std::slice::from_ref(item),
        });
        let flat: Option<Vec<f64>> = flat.map(Value::as_f64).collect();
        numbers.extend(flat?);
    }
    Some(numbers)
}

/// First non-empty text with that key, without a leading `/`.
fn find_name(value: &Value, key: &str) -> Option<String> {
    match value {
        Value::Object(map) => {
            let here =
                map.get(key).and_then(Value::as_str).map(|name| name.trim_start_matches('/'));
            let here = here.filter(|name| !name.is_empty()).map(str::to_owned);
            here.or_else(|| map.values().find_map(|value| find_name(value, key)))
        }
        Value::Array(items) => items.iter().find_map(|value| find_name(value, key)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ur_literal_is_a_rotation_vector_in_metres() {
        let pose_text = parse_pose("p[0.1, -0.2, 0.3, 1.2, -1.7, 0.6]").unwrap();
        assert_eq!(pose_text.numbers, [0.1, -0.2, 0.3, 1.2, -1.7, 0.6]);
        assert_eq!(pose_text.encoding, si_encoding(RotationEncoding::Three(Convention::RotVec)));
    }

    #[test]
    fn a_urdf_origin_may_lack_brackets_and_an_attribute() {
        for text in [
            r#"<origin xyz="0.1 0 -0.2" rpy="0 0 0.5"/>"#,
            r#"<origin rpy="0 0 0.5" xyz="0.1 0 -0.2">"#,
            r#"xyz="0.1 0 -0.2" rpy="0 0 0.5""#,
            r#"<joint name="j"><origin xyz="0.1 0 -0.2" rpy="0 0 0.5"/></joint>"#,
        ] {
            assert_eq!(
                parse_pose(text).unwrap().numbers,
                [0.1, 0.0, -0.2, 0.0, 0.0, 0.5],
                "{text}"
            );
        }
        assert_eq!(
            parse_pose(r#"<origin xyz="1 2 3"/>"#).unwrap().numbers,
            [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]
        );
    }

    #[test]
    fn a_ros_message_names_its_frames() {
        let transform = "\
transforms:
- header:
    stamp:
      sec: 12
      nanosec: 5
    frame_id: /base
  child_frame_id: flange
  transform:
    translation:
      x: 0.246
      y: -0.249
      z: 0.619
    rotation:
      x: 0.17
      y: 0.472
      z: -0.074
      w: 0.862
---";
        let pose_text = parse_pose(transform).unwrap();
        assert_eq!(pose_text.numbers, [0.246, -0.249, 0.619, 0.17, 0.472, -0.074, 0.862]);
        assert_eq!(pose_text.parent.as_deref(), Some("base"));
        assert_eq!(pose_text.child.as_deref(), Some("flange"));
        let pose = "{position: {x: 1, y: 2, z: 3}, orientation: {x: 0, y: 0, z: 0, w: 1}}";
        assert_eq!(parse_pose(pose).unwrap().numbers, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        let echo = "- Translation: [1.0, 2.0, 3.0]\n- Rotation: in Quaternion [0.0, 0.0, 0.0, 1.0]";
        assert_eq!(parse_pose(echo).unwrap().numbers, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(parse_pose(&format!("{echo}\n{echo}")), Err(DeskError::Several(2)));
    }

    #[test]
    fn numbers_may_have_brackets_and_a_true_minus() {
        let pose_text = parse_pose("[[0.1, −0.2; 0.3] (1, 0, 0, 0)]").unwrap();
        assert_eq!(pose_text.numbers, [0.1, -0.2, 0.3, 1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn arrays_of_numpy_and_lists_of_yaml_are_numbers() {
        let six = [0.1, -0.2, 0.3, 1.2, -1.7, 0.6];
        for text in [
            "array([ 0.1, -0.2,  0.3,  1.2, -1.7,  0.6])",
            "np.array([0.1, -0.2, 0.3, 1.2, -1.7, 0.6], dtype=np.float32)",
            "[np.float64(0.1), np.float64(-0.2), np.float64(0.3), np.float64(1.2), np.float64(-1.7), 0.6]",
            "tensor([0.1, -0.2, 0.3, 1.2, -1.7, 0.6], device='cuda:0', dtype=torch.float64)",
            "[ 0.1 -0.2  0.3  1.2 -1.7  0.6]",
            "home_pose: [0.1, -0.2, 0.3, 1.2, -1.7, 0.6]",
            "home_pose:\n  - 0.1\n  - -0.2\n  - 0.3\n  - 1.2\n  - -1.7\n  - 0.6",
            "- 0.1\n- -0.2\n- 0.3\n- 1.2\n- -1.7\n- 0.6",
            "- [0.1, -0.2, 0.3]\n- [1.2, -1.7, 0.6]",
            "- - 0.1\n  - -0.2\n  - 0.3\n- - 1.2\n  - -1.7\n  - 0.6",
        ] {
            let pose_text = parse_pose(text).unwrap();
            assert_eq!(pose_text.numbers, six, "{text}");
            assert_eq!(pose_text.encoding, KnownEncoding::default(), "{text}");
        }
        let matrix = "array([[0., -1., 0., 0.3],\n       [1., 0., 0., 0.1],\n       [0., 0., 1., 0.5],\n       \
                      [0., 0., 0., 1.]])";
        assert_eq!(parse_pose(matrix).unwrap().numbers.len(), 16);
        let lists = "translation: [0.1, -0.2, 0.3]\nrotation: [0, 0, 0, 1]";
        let pose_text = parse_pose(lists).unwrap();
        assert_eq!(pose_text.numbers, [0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(pose_text.encoding.rotation, None);
        let words = parse_pose("array([1, 2, x, 4, 5, 6])").unwrap_err().to_string();
        assert!(words.contains("`x`"), "{words}");
    }

    #[test]
    fn controller_output_states_its_encoding() {
        let coded =
            |vendor: &str| vendors::find(vendor).map(|vendor| (vendor.coding, vendor.units));
        let six = [600.0, -10.5, 200.0, 10.0, 20.0, -30.0];
        for (text, vendor) in [
            ("{X 600.0, Y -10.5, Z 200.0, A 10.0, B 20.0, C -30.0}", "kuka"),
            ("{E6POS: X 600, Y -10.5, Z 200, A 10, B 20, C -30, S 2, T 35, E1 0, E2 0}", "kuka"),
            ("DECL E6POS XP1={X 600.0,Y -10.5,Z 200.0,A 10.0,B 20.0,C -30.0,S 2,T 35}", "kuka"),
            (
                "P[1]{\n GP1:\n UF : 0, UT : 1, CONFIG : 'NUT, 0, 0, 0',\n X = 600.000 mm, Y = -10.500 mm, \
                 Z = 200.000 mm,\n W = 10.000 deg, P = 20.000 deg, R = -30.000 deg\n};",
                "fanuc",
            ),
            ("{{600,-10.5,200,10,20,-30},{sfree,efree,wfree}}", "staubli"),
            ("X:600 Y:-10.5 Z:200 O:10 A:20 T:-30", "kawasaki"),
            ("X: 600.0 Y: -10.5 Z: 200.0 U: 10 V: 20 W: -30", "epson"),
        ] {
            let pose_text = parse_pose(text).unwrap();
            assert_eq!(pose_text.numbers, six, "{text}");
            assert_eq!(
                pose_text.encoding.rotation.map(|form| (form, pose_text.encoding.units)),
                coded(vendor),
                "{text}"
            );
        }
        let rapid = "CONST robtarget p10:=[[600,-10.5,200],[0.5,0.5,-0.5,0.5],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];";
        let pose_text = parse_pose(rapid).unwrap();
        assert_eq!(pose_text.numbers, [600.0, -10.5, 200.0, 0.5, 0.5, -0.5, 0.5]);
        assert_eq!(pose_text.encoding.rotation, Some(RotationEncoding::Wxyz));
        assert_eq!(
            parse_pose("[[0.6, 0, 0.2], [0, 0, 0, 1]]").unwrap().encoding,
            KnownEncoding::default()
        );
        let script = parse_pose("movel(p[0.1, -0.2, 0.3, 1.2, -1.7, 0.6], a=1.2, v=0.25)").unwrap();
        assert_eq!(script.numbers, [0.1, -0.2, 0.3, 1.2, -1.7, 0.6]);
        assert_eq!(
            parse_pose("pose_trans(p[0,0,0,0,0,0], p[1,0,0,0,0,0])"),
            Err(DeskError::Several(2))
        );
    }

    #[test]
    fn units_may_follow_the_numbers() {
        for text in [
            "243.69mm -249.04mm 618.32mm 149.49° -12.78° 72.64°",
            "243.69 mm, -249.04, 618.32, 149.49 deg, -12.78, 72.64",
        ] {
            let pose_text = parse_pose(text).unwrap();
            assert_eq!(
                pose_text.numbers,
                [243.69, -249.04, 618.32, 149.49, -12.78, 72.64],
                "{text}"
            );
            let units = pose_text.encoding.units;
            assert_eq!(units.length, Some(LengthScale::MILLIMETRE), "{text}");
            assert_eq!(units.angle, Some(AngleUnit::Degree), "{text}");
        }
        let named = parse_pose("x: 0.1 y: 0.2 z: 1e-3 qx: 0 qy: 0 qz: 0 qw: 1").unwrap();
        assert_eq!(
            (named.numbers[2], named.encoding.rotation),
            (1e-3, Some(RotationEncoding::Xyzw))
        );
    }

    #[test]
    fn invalid_poses_are_rejected_with_a_reason() {
        for (text, part) in [
            ("1 2 3 4 5", "5 numbers"),
            ("1 2 x 4 5 6", "`x`"),
            ("1 2 nan 4 5 6", "`nan`"),
            ("p[1 2 3]", "rotvec"),
            ("<origin xyz=\"1 2\"/>", "2 numbers"),
            ("<origin xyz=1/>", "XML"),
            ("position: {x: 1}", "no position and orientation"),
            ("position: {x: 1}\norientation: {x: 0, y: 0, z: 0, w: 1}", "x, y, z of"),
            ("", "0 numbers"),
        ] {
            let said = parse_pose(text).unwrap_err().to_string();
            assert!(said.contains(part), "{text}: {said}");
        }
    }
}
