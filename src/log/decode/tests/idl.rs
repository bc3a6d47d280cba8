//! CDR by definitions in IDL.

use super::super::super::testing::Cdr;
use super::super::*;
use super::{decode_all, refused};
use ground::stream::Columns;

/// As rosidl generates it and rosbag2 stores it.
const IMU: &str = r#"================================================================================
IDL: sensor_msgs/msg/Imu
// generated from rosidl_adapter/resource/msg.idl.em
#include "geometry_msgs/msg/Quaternion.idl"

module sensor_msgs {
  module msg {
    typedef double double__9[9];
    @verbatim (language="comment", text=
      "This is a message to hold data from an IMU (Inertial Measurement Unit)" "\n"
      "struct } in a text; // and \" a quote")
    struct Imu {
      std_msgs::msg::Header header;

      geometry_msgs::msg::Quaternion orientation;

      @verbatim (language="comment", text=
        "Row major about x, y, z axes")
      double__9 orientation_covariance;

      @unit(value="rad/s")
      geometry_msgs::msg::Vector3 angular_velocity;
      double__9 angular_velocity_covariance;
      /* a comment
         of two lines; struct */
      geometry_msgs::msg::Vector3 linear_acceleration;
      double__9 linear_acceleration_covariance;
    };
  };
};

================================================================================
IDL: geometry_msgs/msg/Quaternion
module geometry_msgs { module msg {
    struct Quaternion {
      @default (value=0.0)
      double x;
      @default (value=0.0)
      double y;
      @default (value=0.0)
      double z;
      @default (value=1.0)
      double w;
    };
  };
};
================================================================================
IDL: geometry_msgs/msg/Vector3
module geometry_msgs { module msg { struct Vector3 { double x, y, z; }; }; };
================================================================================
IDL: std_msgs/msg/Header
module std_msgs { module msg {
    struct Header { builtin_interfaces::msg::Time stamp; string frame_id; };
}; };
================================================================================
IDL: builtin_interfaces/msg/Time
module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
"#;

/// Joint states among all that the language has.
const JOINTS: &str = r"
module sensor_msgs {
  module msg {
    module JointState_Constants {
      const uint32 SIDE = 3;
      const string TEXT = 'a;b';
      const double HALF = -0.5;
    };
    enum Kind { @value(4) FIRST, SECOND };
    typedef sequence<double, 8> Row;
    typedef Row Rows[2];
    typedef string<32> Name;
    typedef unsigned long long Big, Bigs[2];
    struct Inner { octet a; Big b; };
    @final @nested
    struct JointState {
      @key long long id;
      Kind kind;
      Rows rows;
      sequence<Inner> inners;
      short small[2][JointState_Constants::SIDE];
      Bigs bigs;
      sequence<sequence<float>, 0x10> floats;
      boolean flags[010];
      std_msgs::msg::Header header;
      sequence<Name> name;
      Row position;
      ::sensor_msgs::msg::Row velocity;
      Strange strange;
      @optional double more;
      wstring wide;
    };
    union Strange switch (long) { case 1: double x; };
    struct Later;
  };
};
module std_msgs { module msg { struct Header { ::builtin_interfaces::msg::Time stamp; string _frame_id; }; }; };
";

fn format<'a>(type_name: &'a str, schema: &'a str) -> Format<'a> {
    let (encoding, schema_encoding) = ("cdr", "ros2idl");
    Format { encoding, type_name, schema_encoding, schema: schema.as_bytes() }
}

#[test]
fn files_as_rosidl_writes_them() {
    let cdr = Cdr::little().header(1, 2, "imu").all(&[0.0, 0.6, 0.0, 0.8]).all(&[0.0; 9]);
    let cdr = cdr.all(&[0.1, 0.2, 0.3]).all(&[0.0; 9]).all(&[1.0, 2.0, 9.5]).all(&[0.0; 9]);
    let (parts, error) = decode_all(format("sensor_msgs/msg/Imu", IMU), &[cdr.done()]);
    let Some(Columns::Imu(imu)) = &parts[0].1 else { panic!("imu") };
    assert_eq!(error, None);
    assert_eq!((imu.times.header[0], imu.frame_id.as_str()), (1_000_000_002, "imu"));
    assert_eq!((imu.q_xyzw[0], imu.gyro[0]), ([0.0, 0.6, 0.0, 0.8], [0.1, 0.2, 0.3]));
    assert_eq!(imu.accel, [[1.0, 2.0, 9.5]]);
}

#[test]
fn all_that_the_language_has() {
    let cdr = Cdr::little().u32(7).u32(0).u32(4);
    let cdr = cdr.list(&[1.0, 2.0]).list(&[]);
    let cdr = cdr.u32(2).u8(1).f64(0.0).u8(2).f64(0.0);
    let cdr = (0..6).fold(cdr, |cdr, value| cdr.u16(value)).f64(0.0).f64(0.0);
    let cdr = cdr.u32(2).u32(1).f32(1.0).u32(2).f32(2.0).f32(3.0);
    let cdr = (0..8).fold(cdr, |cdr, _| cdr.u8(1)).header(3, 4, "base");
    let cdr = cdr.texts(&["a", "bc"]).list(&[0.25, -1.5]).list(&[1.0, 2.0]);
    let message = cdr.u32(1).f64(9.0).done();
    let (parts, error) = decode_all(format("sensor_msgs/msg/JointState", JOINTS), &[message]);
    let Some(Columns::Joints(joints)) = &parts[0].1 else { panic!("joints") };
    assert_eq!(error, None);
    assert_eq!((joints.times.header[0], joints.frame_id.as_str()), (3_000_000_004, "base"));
    let found: Vec<_> =
        joints.joints.iter().map(|j| (j.name.as_str(), j.position[0], j.velocity[0])).collect();
    assert_eq!(found, [("a", 0.25, 1.0), ("bc", -1.5, 2.0)]);
}

#[test]
fn annotations_say_where_the_second_cdr_has_lengths() {
    let point = |annotation: &str| {
        format!(
            "module std_msgs {{ module msg {{ @final struct Float64MultiArray {{ Point first; \
             sequence<double> data; }}; {annotation} struct Point {{ long x; }}; }}; }};"
        )
    };
    let data: &[u8] = &[1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf8, 0x3f];
    let x: &[u8] = &[9, 0, 0, 0];
    let length: &[u8] = &[4, 0, 0, 0];
    for (annotation, header, before) in [
        ("@final", 9, false),
        ("@appendable", 7, true),
        ("@extensibility(APPENDABLE)", 9, true),
        ("", 7, false),
        ("", 9, true),
    ] {
        let schema = point(annotation);
        let head: &[u8] = &[0, header, 0, 0];
        let message = [head, if before { length } else { &[] }, x, data].concat();
        let format = format("std_msgs/msg/Float64MultiArray", &schema);
        let (parts, error) = decode_all(format, &[message]);
        let Some(Columns::Array(array)) = &parts[0].1 else { panic!("array") };
        assert_eq!((error, &array.values[..]), (None, &[1.5][..]), "{annotation} {header}");
    }
    let mutable = point("@mutable");
    let refusal = refused(format("std_msgs/msg/Float64MultiArray", &mutable));
    assert!(refusal.contains("in which every field carries its id"), "{refusal}");
}

#[test]
fn broken_files_name_the_line() {
    for (schema, expected) in [
        ("module a {\n  struct B { double x }; };", "line 2: expected `;`, found `}; };`"),
        ("module a {\n struct B { double 3; }; };", "line 2: expected the name of a member"),
        ("struct A { sequence<double x; };", "line 1: expected `>`"),
        ("struct A { double x[0]; };", "expected a length from 1 to 4294967295"),
        ("struct A { double x[65536][65537]; };", "expected a length"),
        ("struct A { unsigned double x; };", "expected a type, found `unsigned double`"),
        ("interface A {};", "expected `module`, `struct`"),
        ("module a { ", "expected `}`, found `the end`"),
        ("enum A { X, Y", "expected `}`"),
        ("struct A { double x; };", "does not define `sensor_msgs/msg/Imu`"),
    ] {
        let refusal = refused(format("sensor_msgs/msg/Imu", schema));
        assert!(refusal.contains(expected), "{schema}: {refusal}");
    }
}

#[test]
fn aliases_in_circles_and_types_in_themselves_are_refused() {
    let circle = "typedef A B; typedef B A; module std_msgs { module msg { \
                  struct String { A a; string data; }; }; };";
    let refusal = refused(format("std_msgs/msg/String", circle));
    assert!(refusal.contains("nested deeper"), "{refusal}");
    let itself = "module std_msgs { module msg { struct String { String s; string data; }; }; };";
    let refusal = refused(format("std_msgs/msg/String", itself));
    assert!(refusal.contains("nested deeper"), "{refusal}");
    let deep = format!("struct A {{ {}double{} x; }};", "sequence<".repeat(99), ">".repeat(99));
    assert!(refused(format("std_msgs/msg/String", &deep)).contains("nested deeper"));
    let modules = "module a { ".repeat(100_000);
    assert!(refused(format("std_msgs/msg/String", &modules)).contains("nested deeper"));
}
