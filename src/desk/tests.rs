//! Pairs of poses with a known difference.
//!
//! Poses are the catalogue's check values; pendant values by SciPy 1.17.1, rounded as on pendants.

use crate::geometry::{AngleUnit, LengthScale};
use crate::robot::catalogue;

use super::*;

/// Poses by URDF, and with a TCP of (10, −20, 149.9) mm, rotated 30° about z.
const UR3E_WITH_TOOL: &str = "\
0.4567 0.2231 0.0665 -0.0000 -0.7071 -0.7071 0.0000,-0.4468 -0.3730 0.0465 1.5316 -0.4104 0.4104
0.3460 -0.0519 0.0882 -0.4803 -0.3676 -0.7437 0.2846,-0.4024 -0.0817 0.1322 0.5253 -1.2728 1.0641
-0.1053 0.4836 0.3793 -0.3762 -0.0738 0.7402 0.5524,0.1869 -0.5458 0.4909 0.0547 0.8034 -0.7185
";

#[derive(Default)]
struct Asked<'a> {
    is: &'a str,
    but: &'a str,
    is_as: &'a str,
    but_as: &'a str,
    robot: &'a str,
    frames: [&'a str; 4],
}

impl Asked<'_> {
    #[track_caller]
    fn answer(&self) -> Reconciliation {
        answer(
            self,
            vec![Pair {
                pose_a: parse_pose(self.is).unwrap(),
                pose_b: parse_pose(self.but).unwrap(),
            }],
        )
    }
}

#[track_caller]
fn answer(asked: &Asked, pairs: Vec<Pair>) -> Reconciliation {
    let known = |text: &str| match text {
        "" => KnownEncoding::default(),
        text => text.parse().unwrap(),
    };
    let [a, b, c, d] = asked.frames.map(|name| (!name.is_empty()).then(|| name.to_owned()));
    let frames = FrameCandidates::from_robot(
        catalogue::find(asked.robot),
        &FrameNames { parent: a, child: b },
        &FrameNames { parent: c, child: d },
    );
    let question = ReconcileInput {
        pairs,
        encoding_a: known(asked.is_as),
        encoding_b: known(asked.but_as),
        frames,
    };
    reconcile(&question).unwrap()
}

fn best(answer: &Reconciliation) -> (String, String, Vec<String>) {
    let best = &answer.hypotheses[0];
    (best.encoding_a.to_string(), best.encoding_b.to_string(), best.claims())
}

#[track_caller]
fn assert_read(answer: &Reconciliation, is: &str, but: &str) {
    let (found_is, found_but, claims) = best(answer);
    assert_eq!((found_is.as_str(), found_but.as_str()), (is, but), "{claims:?}");
}

#[track_caller]
fn assert_plain(answer: &Reconciliation) {
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled, "{:#?}", answer.hypotheses);
    assert!(best(answer).2.is_empty(), "{:?}", best(answer).2);
}

#[test]
fn ur10e_flange_against_the_pendant() {
    // UR driver issue 791.
    let answer = Asked {
        is: "0.246 -0.249 0.619 0.170 0.472 -0.074 0.862",
        but: "243.69 -249.04 618.32 149.49 -12.78 72.64",
        ..Asked::default()
    }
    .answer();
    assert_read(&answer, "quat:xyzw, m", "euler:xyz, deg, mm");
    let first = &answer.hypotheses[0];
    let EndTransform::Frames(tip) = &first.tip else { panic!("{:?}", first.claims()) };
    assert_eq!((tip.frame_a.as_str(), tip.frame_b.as_str()), ("flange", "tool0"));
    assert!((first.residual.rotation_rad.to_degrees() - 0.22).abs() < 0.02, "{first:?}");
    assert!((first.residual.position_m.unwrap() - 0.0024).abs() < 0.0001, "{first:?}");
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
    assert!(answer.hypotheses[1..].iter().all(|other| !other.residual.is_agreement()));
}

#[test]
fn kukas_abc() {
    let answer = Asked {
        is: "-0.3033 -0.1710 1.1298 -0.0208 0.0450 -0.9155 0.3992",
        but: "-303.34 -170.99 1129.84 -132.88 -0.12 -5.68",
        ..Asked::default()
    }
    .answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "euler:ZYX, deg, mm");
}

#[test]
fn staublis_moving_axes() {
    let answer = Asked {
        is: "0.4038 -0.4235 0.1412 0.8201 0.5043 -0.0831 0.2573",
        but: "403.78 -423.51 141.23 149.35 7.08 -61.24",
        ..Asked::default()
    }
    .answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "euler:XYZ, deg, mm");
}

#[test]
fn doosans_and_kawasakis_zyz() {
    let answer = Asked {
        is: "-0.0086 0.0067 1.2498 -0.2254 -0.2548 0.4600 0.8201",
        but: "-8.58 6.72 1249.76 167.79 39.78 -109.21",
        ..Asked::default()
    }
    .answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "euler:ZYZ, deg, mm");
}

#[test]
fn abbs_quaternion_begins_with_w() {
    let asked = Asked {
        is: "0.3102 -0.3322 1.2466 0.2029 -0.0915 0.5186 0.8255",
        but: "310.23 -332.19 1246.63 0.82554 0.20292 -0.09150 0.51859",
        ..Asked::default()
    };
    let answer = asked.answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "quat:wxyz, mm");
    let same = Asked { but: asked.is, ..asked }.answer();
    assert_plain(&same);
    let orders = same.hypotheses[0].equivalents[0].map(|encoding| encoding.rotation.to_string());
    assert_eq!(orders, ["quat:wxyz", "quat:wxyz"]);
}

#[test]
fn fanucs_pendant_against_the_flange_of_ros_industrial() {
    let answer = Asked {
        is: "0.4200 -0.4371 0.2654 -0.5951 0.5964 0.0775 0.5331",
        but: "420.03 -437.09 265.35 143.33 24.81 53.21",
        is_as: "ros",
        but_as: "fanuc",
        robot: "fanuc_lrmate200id",
        ..Asked::default()
    }
    .answer();
    let EndTransform::Frames(tip) = &answer.hypotheses[0].tip else {
        panic!("{:?}", best(&answer))
    };
    assert_eq!(tip.frame_b, "tool0");
    assert!(
        tip.frame_a == "flange" || tip.also.iter().any(|also| also.starts_with("flange → tool0"))
    );
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
}

#[test]
fn frankas_matrix_goes_by_columns() {
    let answer = Asked {
        is: "-0.0060 -0.5920 0.8737 0.7641 -0.3230 -0.2442 0.5022",
        but: "0.672042 -0.738909 -0.048706 0 -0.248425 -0.286928 0.925180 0 \
              -0.697599 -0.609660 -0.376391 0 -0.006005 -0.591972 0.873672 1",
        ..Asked::default()
    }
    .answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "matrix:columns, m");
}

#[test]
fn frankas_hand_stands_45_degrees_on_its_flange() {
    let answer = Asked {
        is: "-0.0060 -0.5920 0.8737 0.7641 -0.3230 -0.2442 0.5022",
        but: "-0.0060 -0.5920 0.8737 0.8296 -0.0060 -0.4178 0.3705",
        is_as: "ros",
        but_as: "ros",
        ..Asked::default()
    }
    .answer();
    let claims = best(&answer).2;
    assert_eq!(claims, ["A is of fr3_link8, B of fr3_hand (Franka)"]);
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
}

#[test]
fn urs_base_is_turned_against_base_link() {
    let asked = Asked {
        is: "-0.0563 0.7802 0.5273 -0.3762 -0.0738 0.7402 0.5524",
        but: "p[0.0563, -0.7802, 0.5273, -0.1620, 0.8252, -1.2118]",
        is_as: "ros",
        robot: "ur5e",
        frames: ["base_link", "tool0", "base", "tool0"],
        ..Asked::default()
    };
    let answer = asked.answer();
    assert_eq!(best(&answer).2, ["A is in base_link, B in base (ur5e)"]);
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
    let unnamed = Asked { robot: "", frames: [""; 4], ..asked }.answer();
    let claim = &best(&unnamed).2[0];
    assert!(claim.starts_with("one is in ") && claim.contains("the other in "), "{claim}");
}

#[test]
fn the_sample_of_jakas_sdk_against_forward_kinematics() {
    // Vendor's manual, 4.8.1 and 4.8.2, rad. It does not name the arm; all of this design have this
    // orientation.
    let arm = catalogue::find("jaka_zu7").unwrap();
    let [base, tip] = [arm.root(), arm.leaf_links().last().unwrap()];
    let rotation =
        arm.chain(base, tip).unwrap().forward(&[0.558, 0.872, 0.872, 0.349, 0.191, 0.191]).rotation;
    let fk = crate::geometry::xyzw_from_rotation(&rotation).map(|c| c.to_string()).join(" ");
    let answer =
        Asked { is: &fk, but: "-1.81826 -0.834253 -2.30243", is_as: "ros", ..Asked::default() };
    let answer = answer.answer();
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw", "euler:xyz, rad");
    assert!(answer.hypotheses[0].residual.rotation_rad < 2e-5);
}

#[test]
fn an_inverse_is_identified() {
    let answer = Asked {
        is: "-0.0563 0.7802 0.5273 -0.3762 -0.0738 0.7402 0.5524",
        but: "-0.4368 0.5294 -0.6472 0.3762 0.0738 -0.7402 0.5524",
        is_as: "ros",
        but_as: "ros",
        ..Asked::default()
    }
    .answer();
    assert_eq!(answer.hypotheses[0].inversion, Inversion::Pose);
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
}

#[test]
fn a_rotation_vector_interpreted_as_euler_angles_is_identified() {
    // As in mecheye_python_samples issue 44.
    let answer = Asked {
        is: "-0.0563 0.7802 0.5273 -0.3762 -0.0738 0.7402 0.5524",
        but: "-0.0563 0.7802 0.5273 0.6662 -0.3794 -0.2143 0.6052",
        is_as: "ros",
        but_as: "ros",
        ..Asked::default()
    }
    .answer();
    let misinterpretation = answer.hypotheses[0].misinterpretation.expect("it is one");
    let names =
        [misinterpretation.is, misinterpretation.read_as].map(|convention| convention.to_string());
    assert_eq!(names, ["rotvec", "euler:ZYX"]);
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
}

#[test]
fn several_pairs_determine_a_tool_that_one_pair_suggests() {
    let asked = Asked { is_as: "ros", but_as: "ur", robot: "ur3e", ..Asked::default() };
    let pairs = pairs_from_csv(UR3E_WITH_TOOL).unwrap();
    let alone = reconcile(&ReconcileInput {
        pairs: pairs[..1].to_vec(),
        encoding_a: "ros".parse().unwrap(),
        encoding_b: "ur".parse().unwrap(),
        frames: FrameCandidates::default(),
    })
    .unwrap();
    assert_eq!(alone.verdict, ReconcileVerdict::Unexplained);
    assert!(alone.single_pair_offsets.is_some());

    let answer = answer(&asked, pairs);
    let first = &answer.hypotheses[0];
    let EndTransform::Fitted(tool) = &first.tip else { panic!("{:?}", first.claims()) };
    assert!((tool.translation.vector.norm() - 0.15156).abs() < 2e-4, "{tool}");
    assert!((tool.rotation.angle().to_degrees() - 30.0).abs() < 0.05, "{tool}");
    assert_ne!(first.base, EndTransform::None, "{:?}", first.claims());
    assert_eq!(answer.verdict, ReconcileVerdict::Reconciled);
}

#[test]
fn ambiguous_encodings_are_listed() {
    // About z, all Tait–Bryan orders and the rotation vector have one nonzero number.
    let answer = Asked {
        is: "0.3 0.1 0.5 0 0 0.7071 0.7071",
        but: "300 100 500 0 0 90",
        is_as: "ros",
        ..Asked::default()
    }
    .answer();
    let first = &answer.hypotheses[0];
    assert_eq!(first.encoding_b.rotation.to_string(), "rotvec");
    assert!(first.equivalents.len() >= 5, "{:?}", first.equivalents);
    assert_eq!(answer.verdict, ReconcileVerdict::Ambiguous);
}

#[test]
fn a_second_pair_removes_the_ambiguity() {
    let text = "\
0.3 0.1 0.5 0 0 0.7071 0.7071,300 100 500 90 0 0
-0.3033 -0.1710 1.1298 -0.0208 0.0450 -0.9155 0.3992,-303.34 -170.99 1129.84 -132.88 -0.12 -5.68
";
    let pairs = pairs_from_csv(text).unwrap();
    let asked = Asked { is_as: "ros", ..Asked::default() };
    assert_eq!(answer(&asked, pairs[..1].to_vec()).verdict, ReconcileVerdict::Ambiguous);
    let answer = answer(&asked, pairs);
    assert_plain(&answer);
    assert_read(&answer, "quat:xyzw, m", "euler:ZYX, deg, mm");
}

#[test]
fn gimbal_lock_and_rounding_are_noted() {
    let answer = Asked {
        is: "0.5 0 0 0.13 0.6 -0.37 0.7",
        but: "500 0 0 10 88 20",
        is_as: "ros",
        but_as: "fanuc",
        ..Asked::default()
    }
    .answer();
    assert!(answer.notes.iter().any(|note| note.starts_with("A deviates from a rotation by")));
    assert!(answer.notes.iter().any(|note| note.contains("within 2.00° of gimbal lock")));
}

#[test]
fn unusual_units_are_stated_in_the_encoding() {
    let answer = Asked {
        is: "0.3 0.1 0.5 0 0 0.0436 0.9990",
        but: "0.3 0.1 0.5 0 0 5",
        is_as: "ros",
        ..Asked::default()
    }
    .answer();
    assert!(best(&answer).1.contains("deg"), "{:?}", best(&answer));
}

#[test]
fn one_pair_suggests_a_tool_without_claiming_it() {
    let answer = Asked {
        is: "0.246 -0.249 0.619 0 0.7071 0 0.7071",
        but: "0.436 -0.249 0.619 0 0.7071 0 0.7071",
        is_as: "quat:xyzw",
        but_as: "quat:xyzw",
        ..Asked::default()
    }
    .answer();
    assert_eq!(answer.verdict, ReconcileVerdict::Unexplained);
    assert_read(&answer, "quat:xyzw, m", "quat:xyzw, m");
    let would_do = answer.single_pair_offsets.unwrap();
    assert_eq!(would_do.translation_text().as_deref(), Some("190.0 mm along tool z or base x"));
    assert!((would_do.tool.translation.vector.z - 0.19).abs() < 1e-4, "{}", would_do.tool);
}

#[test]
fn unrelated_poses_stay_unexplained() {
    let answer = Asked {
        is: "0.246 -0.249 0.619 0.170 0.472 -0.074 0.862",
        but: "0.8 0.1 0.2 0.51 0.13 0.61 0.59",
        is_as: "ros",
        but_as: "ros",
        ..Asked::default()
    }
    .answer();
    assert_eq!(answer.verdict, ReconcileVerdict::Unexplained, "{:?}", answer.hypotheses[0]);
    assert!(answer.single_pair_offsets.is_some());
}

#[test]
fn a_vendor_name_implies_encoding_and_units() {
    let kuka: KnownEncoding = "kuka".parse().unwrap();
    assert_eq!(kuka.rotation.map(|form| form.to_string()).as_deref(), Some("euler:ZYX"));
    let (mm, degrees) = (Some(LengthScale::MILLIMETRE), Some(AngleUnit::Degree));
    assert_eq!((kuka.units.length, kuka.units.angle), (mm, degrees));
    assert!("kuka,rad,deg".parse::<KnownEncoding>().is_err());
    let in_radians: KnownEncoding = "kuka,rad".parse().unwrap();
    assert_eq!((in_radians.units.length, in_radians.units.angle), (mm, Some(AngleUnit::Radian)));
}
