//! Trajectories in the formats of public data sets and of evo.

use std::fs;
use std::path::PathBuf;

use super::{csv, plain, read, refusal, topic};
use crate::{ColumnSettings, Container, Log, LogError, ReadOptions, open};
use ground::stream::{Columns, PoseColumns};

/// TUM RGB-D, recorded at 100 Hz.
const TUM: &str = "# ground truth trajectory\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n\
    # timestamp tx ty tz qx qy qz qw\n\
    1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n\
    1305031098.6758 1.3543 0.6306 1.6360 0.6129 0.5966 -0.3316 -0.3980\n\
    1305031098.6858 1.3525 0.6306 1.6339 0.6136 0.5971 -0.3312 -0.3966\n\
    1305031098.6959 1.3502 0.6306 1.6318 0.6139 0.5972 -0.3312 -0.3959\n";
/// EuRoC, `state_groundtruth_estimate0/data.csv`.
const EUROC: &str = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], \
    q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1]\n\
    1403715524907143168,0.515356,1.996773,0.971104,0.161996,0.789985,-0.205376,0.554528,-0.002,-0.009,-0.005,0.1\n\
    1403715524912143104,0.515344,1.996730,0.971078,0.161957,0.789966,-0.205460,0.554536,-0.002,-0.008,-0.005,0.1\n\
    1403715524917143040,0.515332,1.996688,0.971052,0.161916,0.789948,-0.205541,0.554545,-0.002,-0.008,-0.005,0.1\n";
/// KITTI odometry, sequence 00.
const KITTI: &str = "1.000000e+00 9.043680e-12 2.326809e-11 5.551115e-17 9.043683e-12 1.000000e+00 2.392370e-10 \
    3.330669e-16 2.326810e-11 2.392370e-10 9.999999e-01 -4.440892e-16\n\
    9.999978e-01 5.272628e-04 -2.066935e-03 -4.690294e-02 -5.296506e-04 9.999992e-01 -1.154865e-03 \
    -2.839928e-02 2.066324e-03 1.155958e-03 9.999971e-01 8.586941e-01\n\
    9.999910e-01 1.048972e-03 -4.131348e-03 -9.374345e-02 -1.058514e-03 9.999968e-01 -2.308104e-03 \
    -5.676064e-02 4.128913e-03 2.312456e-03 9.999887e-01 1.716275e+00\n";
const KITTI_TIMES: &str = "0.000000e+00\n1.037359e-01\n2.073381e-01\n";

fn poses<'a>(log: &'a Log, name: &str) -> &'a PoseColumns {
    match &topic(log, name).columns {
        Some(Columns::Poses(poses)) if poses.len() == 1 => &poses[0],
        other => panic!("no poses: {other:?}"),
    }
}

/// Writes the files to a folder and opens the first `opened`.
pub(super) fn open_files(files: &[(&str, &str)], opened: usize) -> Result<Log, LogError> {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |(name, content): &(&str, &str)| -> PathBuf {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(&path, content).expect("a file");
        path
    };
    let paths: Vec<PathBuf> = files.iter().map(write).collect();
    open(&paths[..opened], &ReadOptions::default())
}

fn names(log: &Log) -> Vec<&str> {
    log.topics.iter().map(|topic| topic.name.as_str()).collect()
}

#[test]
fn a_tum_trajectory_is_a_pose_stream_with_exact_stamps() {
    let log = plain(TUM.as_bytes());
    assert_eq!((log.files[0].container, names(&log)), (Container::Tum, vec!["table"]));
    let own = poses(&log, "table");
    assert_eq!(own.times.header[..2], [1_305_031_098_665_900_000, 1_305_031_098_675_800_000]);
    assert_eq!(own.xyz[0], [1.3563, 0.6305, 1.6380]);
    assert_eq!(own.q_xyzw[0], [0.6132, 0.5962, -0.3311, -0.3986]);
    assert_eq!(log.losses, []);
    // As numpy writes it, by tabs, with a byte-order mark and without comments.
    let written = "\u{feff}1.403715529112143517e+09\t0\t0\t0\t0\t0\t0\t1\n\
        1.403715529212142944e+09\t0.5\t0\t0\t0\t0\t0\t1\n";
    let header = &poses(&plain(written.as_bytes()), "table").times.header.clone();
    assert_eq!(header[..], [1_403_715_529_112_143_517, 1_403_715_529_212_142_944]);
    // An unusual order, if the file declares it.
    let swapped = TUM.replace("qx qy qz qw", "qw qx qy qz");
    let log = plain(swapped.as_bytes());
    assert_eq!(poses(&log, "table").q_xyzw[0], [0.5962, -0.3311, -0.3986, 0.6132]);
}

#[test]
fn a_sentence_above_a_trajectory_does_not_name_its_columns() {
    let text = TUM.replace("ground truth trajectory", "Thanks to @a for the example data.");
    assert_eq!(names(&plain(text.as_bytes())), ["table"]);
    let text = text.replace(" tx ", " by a kind person, tx ");
    assert_eq!(names(&plain(text.as_bytes())), ["table"]);
}

#[test]
fn faulty_lines_of_a_trajectory_are_lost_with_their_number() {
    let more: String = (0..40).map(|row| format!("{row}.5 {row} 0 0 0 0 0 1\n")).collect();
    for (from, to, expected) in [
        ("7.5 7 0 0", "7.5 7 0", "line 8: 7 columns, not 8"),
        ("7.5 7 0 0", "7.5 nan 0 0", "line 8: 1 of 7 numbers unusable"),
        ("7.5 7 0 0", "7.5 x 0 0", "line 8: 1 of 7 numbers unusable"),
        ("7.5 7 0 0", "nan 7 0 0", "1 of 40 rows have no stamp"),
        ("39.5 39 0 0 0 0 0 1\n", "39.5 39 0", "the file ends within line 40"),
    ] {
        let log = plain(more.replace(from, to).as_bytes());
        assert_eq!(poses(&log, "table").xyz.len(), 39, "{to}");
        assert_eq!((log.losses.len(), log.losses[0].messages), (1, Some(1)), "{to}");
        assert!(log.losses[0].what.contains(expected), "{:?}", log.losses);
    }
    let falling: String = (0..40).map(|row| format!("{}.5 0 0 0 0 0 0 1\n", 90 - row)).collect();
    let line = refusal(falling.as_bytes());
    assert!(
        line.contains("'timestamp [s]' is named as a time, but its numbers never increase"),
        "{line}"
    );
}

#[test]
fn quaternions_of_any_norm_are_read_from_a_file_named_tum() {
    let text = TUM.replace("0.6", "0.1").replace("0.5", "0.1");
    let log = open_files(&[("lost.TUM", &text)], 1).expect("a log");
    assert_eq!((log.files[0].container, names(&log)), (Container::Tum, vec!["lost"]));
}

#[test]
fn a_euroc_pose_is_read_and_its_other_columns_are_listed() {
    let log = open_files(&[("mav0/vicon0/data.csv", EUROC)], 1).expect("a log");
    assert_eq!(names(&log), ["b_w_RS_S", "data", "v_RS_R"]);
    let own = poses(&log, "data");
    assert_eq!(own.times.header[..2], [1_403_715_524_907_143_168, 1_403_715_524_912_143_104]);
    assert_eq!(own.xyz[0], [0.515356, 1.996773, 0.971104]);
    assert_eq!(own.q_xyzw[0], [0.789985, -0.205376, 0.554528, 0.161996]);
    assert!(topic(&log, "v_RS_R").columns.is_none());
    let with_unit = EUROC.replace("#timestamp", "#timestamp [ns]");
    assert_eq!(poses(&plain(with_unit.as_bytes()), "table").times, own.times);
}

#[test]
fn files_of_one_name_are_two_streams() {
    let files = [
        ("a/stamped_traj.txt", TUM),
        ("b/stamped_traj.txt", &TUM.replace("1.35", "1.36")),
        ("b/stamped_traj.csv", EUROC),
        ("b/other.tum", &TUM.replace("1.35", "1.37")),
    ];
    let log = open_files(&files[..2], 2).expect("a log");
    assert_eq!(names(&log), ["a/stamped_traj", "b/stamped_traj"]);
    let log = open_files(&files, 4).expect("a log");
    let own: Vec<&str> = names(&log).into_iter().filter(|name| !name.contains("RS")).collect();
    assert_eq!(own, ["a/stamped_traj", "other", "stamped_traj.csv", "stamped_traj.txt"]);
}

#[test]
fn kitti_poses_take_their_times_from_another_file() {
    let given = open_files(&[("00.txt", KITTI), ("sequence/times.txt", KITTI_TIMES)], 2);
    let beside = open_files(&[("00.txt", KITTI), ("times.txt", KITTI_TIMES)], 1);
    let named = open_files(&[("00.txt", KITTI), ("00_times.txt", KITTI_TIMES)], 1);
    for log in [given, beside, named] {
        let log = log.expect("a log");
        let own = poses(&log, "00");
        // A stamp of 0 means unset.
        assert_eq!(own.times.header[..], [1, 103_735_900, 207_338_100]);
        assert_eq!(own.xyz[2], [-9.374345e-2, -5.676064e-2, 1.716275]);
        let expected = [1.155e-3, -2.065e-3, -5.27e-4, 1.0];
        let errors = own.q_xyzw[2].iter().zip(expected).map(|(own, of)| (own - of).abs());
        assert!(errors.fold(0.0, f64::max) < 2e-5, "{:?}", own.q_xyzw[2]);
        assert_eq!((log.losses, log.notes.len()), (Vec::new(), 2));
    }
}

#[test]
fn kitti_poses_without_their_times_are_refused_in_one_line() {
    let text = |log: Result<Log, LogError>| {
        let line = log.expect_err("refused").to_string();
        assert!(!line.contains('\n') && line.contains("also pass the times file"), "{line}");
        line
    };
    let alone = text(open_files(&[("00.txt", KITTI)], 1));
    assert!(alone.contains("00.txt: 3 KITTI poses without times; "), "{alone}");
    let few = text(open_files(&[("00.txt", KITTI), ("times.txt", "0\n0.1\n")], 1));
    assert!(few.contains("times.txt has 2 times"), "{few}");
    let several = [
        ("00.txt", KITTI),
        ("a/times.txt", KITTI_TIMES),
        ("b/times.txt", &KITTI_TIMES.replace('7', "8")),
    ];
    let several = text(open_files(&several, 3));
    assert!(several.contains("both have 3 times"), "{several}");
    let rate = ColumnSettings { rate_hz: Some(10.0), ..ColumnSettings::default() };
    let log = read(KITTI.as_bytes(), rate).expect("a log");
    assert_eq!(
        poses(&log, "table").times.header[1] - poses(&log, "table").times.header[0],
        100_000_000
    );
}

#[test]
fn faulty_kitti_lines_do_not_shift_the_times() {
    let line = |row: usize| format!("1 0 0 {row} 0 1 0 0 0 0 1 0\n");
    let times: String = (0..20).map(|row| format!("{}\n", 0.1 * row as f64)).collect();
    for (faulty, expected) in [
        ("1 0 0 0 1\n", "line 8: 5 columns, not 12"),
        ("2 0 0 7 0 2 0 0 0 0 2 0\n", "line 8: the first three columns are not a rotation"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0\n", "line 8: 1 of 7 numbers unusable"),
        ("nan 0 0 7 0 1 0 0 0 0 1 0\n", "line 8: 4 of 7 numbers unusable"),
    ] {
        let all = |row| if row == 7 { faulty.to_owned() } else { line(row) };
        let text: String = (0..20).map(all).collect();
        let log = open_files(&[("00.txt", &text), ("times.txt", &times)], 1).expect("a log");
        let own = poses(&log, "00");
        assert_eq!((own.xyz[7][0], own.times.header[7]), (8.0, 800_000_000), "{faulty}");
        assert_eq!((log.losses.len(), log.losses[0].messages), (1, Some(1)), "{faulty}");
        assert!(log.losses[0].what.contains(expected), "{:?}", log.losses);
    }
}

#[test]
fn times_without_poses_are_reported() {
    let files = [("00.txt", KITTI), ("b/00.txt", KITTI_TIMES), ("times.txt", "0\n1\n")];
    let log = open_files(&files, 3).expect("a log");
    assert!(log.notes.iter().any(|note| note.what.contains("no other file has as many rows")));
    let alone = open_files(&[("times.txt", KITTI_TIMES)], 1).expect_err("refused").to_string();
    assert!(alone.contains("a list of times without other numbers"), "{alone}");
}

#[test]
fn clocks_of_two_tables_stay_the_same() {
    let later: String = (0..9).map(|row| format!("{}.7 0 0 0 0 0 0 1\n", 1 + row)).collect();
    let early: String = (0..9).map(|row| format!("{row}.0 0 0 0 0 0 0 1\n")).collect();
    let log = open_files(&[("a.tum", &early), ("b.tum", &later)], 2).expect("a log");
    assert_eq!(poses(&log, "a").times.header[..2], [1, 1_000_000_000]);
    assert_eq!(poses(&log, "b").times.header[0], 1_700_000_000);
    assert_eq!(poses(&log, "b").times.log[0], 1_700_000_000);
}

#[test]
fn two_poses_with_one_clock_are_two_streams() {
    let value = |row: usize, at: usize| 0.01 * row as f64 + at as f64;
    for (of, expected) in [
        (["tracker_{}", "robot_{}"], ["robot", "tracker"]),
        (["a.position.{}", "b.position.{}"], ["a", "b"]),
        (["/left/pose.{}", "/right/pose.{}"], ["left_pose", "right_pose"]),
    ] {
        let mut names = vec!["timestamp".to_owned()];
        for form in of {
            let axes = ["x", "y", "z"].map(|axis| form.replace("{}", axis));
            let turns = ["x", "y", "z", "w"].map(|axis| match form.contains("position") {
                true => form.replace("position.{}", &format!("orientation.{axis}")),
                false => form.replace("{}", &format!("q{axis}")),
            });
            names.extend(axes.into_iter().chain(turns));
        }
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let log = plain(csv(&names, 30, value).as_bytes());
        assert_eq!(self::names(&log), expected);
        for topic in &log.topics {
            assert!(topic.cells[3..].iter().all(|cell| cell.labels.is_some()), "{:?}", topic.cells);
        }
    }
}

#[test]
fn a_file_with_one_unnamed_pose_is_named_after_it() {
    let value = |row: usize, at: usize| 0.01 * row as f64 + at as f64;
    let tum = csv(&["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"], 30, value);
    let other = csv(&["t", "x", "y", "z", "roll", "pitch", "yaw", "quality"], 30, value);
    let echoed = csv(
        &["%time", "field.pose.position.x", "field.pose.position.y", "field.pose.position.z"],
        30,
        value,
    );
    let files = [("a.csv", tum.as_str()), ("b.csv", &other), ("c.csv", &echoed)];
    let log = open_files(&files, 3).expect("a log");
    assert_eq!(names(&log), ["a", "b", "c", "quality"]);
    assert_eq!(poses(&log, "a").q_xyzw[0], [4.0, 5.0, 6.0, 7.0]);
    // A table with joints is an episode of a run.
    let joints = ["t", "x", "y", "z", "roll", "pitch", "yaw", "q1", "q2", "q3", "q4"];
    let log = open_files(&[("a.csv", &csv(&joints, 30, value))], 1).expect("a log");
    assert_eq!(names(&log), ["pose", "q"]);
}
