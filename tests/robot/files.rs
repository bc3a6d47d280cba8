//! Valid and invalid URDF files and DH tables.

use std::f64::consts::FRAC_PI_2;

use poseaudit::geometry::{Pose, Rotation, pose, rotation_from_rpy, xyz_of};
use poseaudit::robot::Robot;

use super::{assert_near, default_chain, urdf};

#[test]
fn a_dh_table_is_a_robot() {
    let text = "
        units = 'm, rad'
        [dh]
        convention = 'modified'
        rows = [[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]]
        joint_names = ['lift', 'spin']
        joint_types = ['prismatic', 'revolute']
        post_xyz = [0.0, 0.0, 0.9]";
    let robot = Robot::from_text(text, "arm.toml").unwrap();
    let chain = default_chain(&robot);
    assert_eq!((chain.base_name(), chain.tip_name()), ("base", "tip"));
    assert_eq!(chain.joint_names(), ["lift", "spin"]);
    let craig = |a, alpha, theta: f64, d: f64| {
        pose([a, 0.0, 0.0], rotation_from_rpy([alpha, 0.0, 0.0]))
            * pose([0.0, 0.0, d], rotation_from_rpy([0.0, 0.0, theta]))
    };
    // Rx and Dx commute, and so do Rz and Dz.
    let expected = craig(0.1, 0.3, 0.4, 0.2 + 0.05)
        * craig(0.5, 0.7, 0.8 + 1.0, 0.6)
        * pose([0.0, 0.0, 0.9], Rotation::identity());
    assert_near(&chain.forward(&[0.05, 1.0]), &expected, 1e-15, "modified");
}

#[test]
fn dh_conventions_differ_in_the_order_of_a_and_alpha() {
    let of = |convention: &str| {
        let text =
            format!("[dh]\nconvention = '{convention}'\nrows = [[1.0, 0.0, {FRAC_PI_2}, 0.0]]");
        default_chain(&Robot::from_toml(&text, "arm.toml").unwrap()).forward(&[FRAC_PI_2])
    };
    let (standard, modified) = (xyz_of(&of("standard")), xyz_of(&of("modified")));
    assert!((standard[1] - 1.0).abs() < 1e-15, "{standard:?}");
    assert!((modified[0] - 1.0).abs() < 1e-15, "{modified:?}");
}

#[test]
fn a_bad_table_is_refused_with_its_line() {
    let fixed = "[[joint]]\nname = 'j'\ntype = 'fixed'\nparent = 'a'\nchild = 'b'\n";
    let cases = [
        ("dof = [", "arm.toml:1: not a robot in TOML: "),
        ("id = 'x'", "arm.toml:1: the file has neither [[joint]] nor [dh]; add one of the two"),
        ("[dh]\nrows = []", "arm.toml:1: not a robot in TOML: missing field `convention`"),
        (
            "[dh]\nconvention = 'craig'\nrows = []",
            "arm.toml:2: not a robot in TOML: unknown variant `craig`, expected `standard` or `modified`",
        ),
        (
            "[dh]\nconvention = 'standard'\nrows = [[0.0, 0.0]]",
            "arm.toml:3: not a robot in TOML: invalid length 2",
        ),
        (
            "[dh]\nconvention = 'standard'\nrows = [[0, 0, 0, nan]]",
            "arm.toml:1: [dh] has a number that is not finite, or beyond 1000000; correct the number",
        ),
        (
            "[dh]\nconvention = 'standard'\njoint_names = ['a']\nrows = []",
            "arm.toml:1: 1 joint_names of [dh] for 0 rows; give one per row",
        ),
        (
            &format!("units = 'mm, deg'\n{fixed}"),
            "arm.toml:1: units are \"mm, deg\", not \"m, rad\"; convert",
        ),
        (
            &format!("{fixed}axes = [0, 0, 1]"),
            "arm.toml:6: not a robot in TOML: unknown field `axes`",
        ),
        (
            &format!("{fixed}xyz = [0, 0, inf]"),
            "arm.toml:1: joint 'j' has a number that is not finite",
        ),
        (&format!("{fixed}{fixed}"), "arm.toml:6: a second joint is named 'j'; rename one of them"),
        (
            &format!("tip = 'c'\n{fixed}"),
            "arm.toml:1: the tip 'c' is not a link of the model; correct the name",
        ),
        (&format!("dof = 1\n{fixed}"), "arm.toml:1: dof = 1, but 0 joints can move; correct dof"),
        (
            &fixed.replace("fixed", "ball"),
            "arm.toml:1: joint 'j': type \"ball\" is unknown; use revolute",
        ),
        (
            &format!("{}axis = [0, 0, 0]", fixed.replace("fixed", "revolute")),
            "arm.toml:1: joint 'j': the axis is zero",
        ),
    ];
    for (text, message) in cases {
        let error = Robot::from_text(text, "arm.toml").unwrap_err().to_string();
        assert!(error.starts_with(message), "{text}\n  gave {error}\n  not  {message}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn a_file_that_is_missing_is_named() {
    let error = Robot::from_file(std::path::Path::new("no/such.urdf")).unwrap_err();
    assert_eq!(
        error.to_string(),
        "no/such.urdf: cannot be read as text; check that it exists and is a URDF or a TOML file"
    );
    assert!(std::error::Error::source(&error).is_some());
}

#[test]
fn urdf_defaults_and_lenient_syntax_are_read() {
    let robot = urdf(
        "<link name='a'><visual><geometry><mesh filename='$(find x)/y.stl' scale='?'/></geometry></visual></link>
         <link name='b'/><link name='c'/>
         <gazebo><joint name='not a joint'/></gazebo><transmission><joint name='j'/></transmission>
         <joint name='j' type='revolute'><parent link='a'/><child link='b'/><limit upper='inf' effort='x'/></joint>
         <joint name='k' type='continuous'><parent link='b'/><child link='c'/><origin xyz=' 1\t2 3 '/>
           <axis xyz='0 0 -4'/><limit lower='0' upper='0' velocity='2'/></joint>",
    );
    let [j, k] = ["j", "k"].map(|name| robot.joint(name).unwrap());
    assert_eq!((j.axis.x, j.parent_from_joint), (1.0, Pose::identity()));
    assert_eq!((j.limits.lower, j.limits.upper, j.limits.velocity), (None, None, None));
    assert_eq!((k.axis.z, xyz_of(&k.parent_from_joint)), (-1.0, [1.0, 2.0, 3.0]));
    assert_eq!((k.limits.lower, k.limits.upper, k.limits.velocity), (None, None, Some(2.0)));
    assert_eq!(robot.link_name(robot.root()), "a");
    let leaves: Vec<&str> = robot.leaf_links().map(|link| robot.link_name(link)).collect();
    assert_eq!(leaves, ["c"]);
    let below: Vec<&str> =
        robot.child_joints(robot.root()).map(|joint| joint.name.as_str()).collect();
    assert_eq!(below, ["j"]);
}

#[test]
fn an_expanded_xacro_with_a_byte_order_mark_is_read() {
    let text = "\u{feff}<?xml version='1.0'?>\n<!DOCTYPE robot>
        <robot xmlns:xacro='http://www.ros.org/wiki/xacro'><link name='base'/></robot>";
    assert!(Robot::from_text(text, "x").unwrap().link("base").is_some());
    let text = text.replace("robot>\n", "robot [<!ENTITY a 'base'>]>\n");
    let error = Robot::from_text(&text, "x").unwrap_err().to_string();
    assert!(error.contains("document type") && error.contains("--noent"), "{error}");
}

#[test]
fn a_bad_urdf_is_refused_with_its_line() {
    let links = "<link name='a'/><link name='b'/>\n";
    let joint = |inside: &str| {
        format!(
            "{links}<joint name='j' type='revolute'><parent link='a'/><child link='b'/>\n{inside}</joint>"
        )
    };
    let bare = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name='{name}' type='fixed'><parent link='{parent}'/><child link='{child}'/></joint>\n"
        )
    };
    let cases = [
        (String::new(), "x:1: the model has no link; give the URDF itself"),
        ("<link/>".to_owned(), "x:2: a <link> has no name; add it"),
        (format!("{links}<joint name='j'/>"), "x:3: joint 'j' has no type attribute; add it"),
        (
            format!("{links}<joint name='j' type='ball'/>"),
            "x:3: joint 'j': type \"ball\" is unknown; use",
        ),
        (
            format!("{links}<joint name='j' type='fixed'/>"),
            "x:3: joint 'j' has no <parent link=…>; add it",
        ),
        (
            joint("<origin xyz='1 2'/>"),
            "x:4: joint 'j': xyz=\"1 2\" is not three finite numbers; correct the number",
        ),
        (
            joint("<origin rpy='0 0 nan'/>"),
            "x:4: joint 'j': rpy=\"0 0 nan\" is not three finite numbers",
        ),
        (
            joint("<origin quat_xyzw='0 0 0 0'/>"),
            "x:4: joint 'j': quat_xyzw=\"0 0 0 0\" is not a quaternion x y z w",
        ),
        (
            joint("<origin xyz='0 1e308 0'/>"),
            "x:3: joint 'j' of link 'b' has the number 1e308; the largest allowed is 1000000; correct the number",
        ),
        (
            joint("<mimic joint='k' multiplier='-1e7'/>"),
            "x:3: joint 'j' of link 'b' has the number 1e7;",
        ),
        (joint("<limit lower='-3,1'/>"), "x:4: joint 'j': lower=\"-3,1\" is not a number"),
        (
            joint("<mimic joint='k' multiplier='inf'/>"),
            "x:4: joint 'j': multiplier=\"inf\" is not a finite number",
        ),
        (
            joint("<axis xyz='0 0 0'/>"),
            "x:3: joint 'j': the axis is zero; give the axis a direction",
        ),
        (
            joint("<origin xyz='${d1} 0 0'/>"),
            "x:4: \"${d1} 0 0\" is a leftover of xacro; expand it first",
        ),
        (
            "<link name='$(arg prefix)a'/>".to_owned(),
            "x:2: \"$(arg prefix)a\" is a leftover of xacro",
        ),
        ("<xacro:ur_robot/>".to_owned(), "x:2: the prefix xacro: is a leftover of xacro"),
        (
            "<a:arg xmlns:a='http://wiki.ros.org/xacro'/>".to_owned(),
            "x:2: <xacro:arg> is a leftover of xacro",
        ),
        (
            "<link name='a'/><link name='a'/>".to_owned(),
            "x:2: a second link is named 'a'; rename one of them",
        ),
        (
            format!("<link name='c'/>{links}{}{}", bare("j", "a", "b"), bare("j", "b", "c")),
            "x:4: a second joint is named 'j'",
        ),
        (
            format!("{links}{}", bare("j", "a", "c")),
            "x:3: joint 'j': its child link 'c' is not declared; add the link",
        ),
        (
            format!("{links}{}", bare("j", "c", "b")),
            "x:3: joint 'j': its parent link 'c' is not declared",
        ),
        (
            format!("{links}{}{}", bare("j", "a", "b"), bare("k", "a", "b")),
            "x:4: link 'b' is the child of two joints, 'j' and 'k'; remove",
        ),
        (
            links.to_owned(),
            "x:2: two links have no parent joint: 'a' and 'b'; join them by a joint",
        ),
        (
            format!("{links}{}{}", bare("j", "a", "b"), bare("k", "b", "a")),
            "x:4: joint 'k' closes a loop; remove the joint",
        ),
        (format!("{links}{}", bare("j", "b", "b")), "x:3: joint 'j' closes a loop"),
    ];
    for (body, message) in cases {
        let text = format!("<robot name='r'>\n{body}</robot>");
        let error = Robot::from_urdf(&text, "x").unwrap_err().to_string();
        assert!(error.starts_with(message), "{body}\n  gave {error}\n  not  {message}");
    }
    for (text, message) in [
        ("<sdf/>", "x:1: the XML's root element is <sdf>, not <robot>; give the arm's URDF"),
        ("<robot>\n<link name='a'>\n</robot>", "x:3: not well-formed XML: "),
        ("", "x:1: not well-formed XML: "),
    ] {
        let error = Robot::from_urdf(text, "x").unwrap_err().to_string();
        assert!(error.starts_with(message), "{text}\n  gave {error}\n  not  {message}");
    }
}

#[test]
fn a_hostile_urdf_causes_no_overflow_and_no_hang() {
    let deep = format!("{}{}", "<link name='a'>".repeat(99), "</link>".repeat(99));
    assert_eq!(urdf(&deep).links().count(), 1);

    let links: String = (0..2_000).map(|i| format!("<link name='l{i}'/>")).collect();
    let joint = |i: usize, to: usize| {
        format!(
            "<joint name='j{i}' type='prismatic'><parent link='l{i}'/><child link='l{to}'/></joint>"
        )
    };
    let line: String = (0..1_999).map(|i| joint(i, i + 1)).collect();
    let robot = urdf(&format!("{links}{line}"));
    let (base, tip) = (robot.link("l0").unwrap(), robot.link("l1999").unwrap());
    let chain = robot.chain(base, tip).unwrap();
    assert_eq!(xyz_of(&chain.forward(&[1e-3; 1_999]))[0].round(), 2.0);

    let mimic = |i: usize| format!("<mimic joint='j{}'/></joint>", i + 1);
    let mimics: String =
        (0..1_998).map(|i| joint(i, i + 1).replace("</joint>", &mimic(i))).collect();
    let robot = urdf(&format!("{links}{mimics}{}", joint(1_998, 1_999)));
    assert_eq!(robot.chain(base, tip).unwrap().joint_names(), ["j1998"]);

    let ring = format!("<robot>{links}{line}{}</robot>", joint(1_999, 0));
    let error = Robot::from_urdf(&ring, "x").unwrap_err().to_string();
    assert!(error.contains("closes a loop"), "{error}");
}
