//! Seeds of the fuzz targets, in `fuzz/seeds/TARGET/`: small valid logs and messages of every kind.

use std::fs;
use std::path::Path;

use super::decode::tests::encodings;
use super::tables::tests as table_writers;
use super::testing::{self, BagWriter, Cdr, DatabaseWriter, LogWriter};
use super::{ReadOptions, open};

const POSE: &str = "geometry_msgs/msg/PoseStamped";

fn pose(n: u32) -> Vec<u8> {
    Cdr::pose_stamped(0, n, "base", [n.into(), 0.5, 0.25])
}

fn mcap(compression: Option<mcap::Compression>) -> Vec<u8> {
    let mut log = LogWriter::new(compression);
    let joints = log.channel("/joint_states", "sensor_msgs/msg/JointState", testing::JOINT_STATE);
    let poses = log.channel("/pose", POSE, testing::POSE_STAMPED);
    for n in 0..5 {
        log.message(joints, n.into(), &Cdr::joint_state(&["a", "b"], &[0.1, 0.2], &[]));
        log.message(poses, n.into(), &pose(n));
    }
    log.finish()
}

fn bag(compression: &'static str) -> Vec<u8> {
    let mut bag = BagWriter::new(compression);
    let definition = "float64[] data";
    let numbers = bag.connection("/numbers", "std_msgs/Float64MultiArray", definition);
    for n in 0..5 {
        let data: Vec<u8> = [&6_u32.to_le_bytes()[..], &[0; 48]].concat();
        bag.message(numbers, n, &data);
        if n == 2 {
            bag.end_chunk();
        }
    }
    bag.finish()
}

fn database(create: fn(&Path) -> DatabaseWriter) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.db3");
    let database = create(&path);
    database.poses(1, "/pose");
    database.count_poses(1, 0, 5);
    drop(database);
    fs::read(path).unwrap()
}

fn rtde() -> Vec<u8> {
    let names = |name: &str| (0..6).map(|n| format!("{name}_{n}")).collect::<Vec<_>>().join(" ");
    let mut table = format!("timestamp {} {}\n", names("actual_q"), names("actual_TCP_pose"));
    for n in 0..5 {
        table += &format!("{}.5{}\n", 100 + n, " 0.25 -1.5 0 1e-3 0.5 0.125".repeat(2));
    }
    table.into_bytes()
}

const METADATA: &[u8] = b"rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  \
    relative_file_paths:\n    - run_0.mcap\n  message_count: 2\n  compression_format: ''\n  files:\n    \
    - path: run_0.mcap\n      message_count: 2\n";

/// Preceded by type and schema, as the targets expect.
fn message(type_name: &str, schema: &[u8], data: &[u8]) -> Vec<u8> {
    let mut seed = vec![type_name.len() as u8];
    seed.extend(type_name.as_bytes());
    seed.extend((schema.len() as u16).to_le_bytes());
    seed.extend(schema);
    seed.extend(data);
    seed
}

fn all() -> Vec<(&'static str, Vec<u8>)> {
    let zstd = |bytes: &[u8]| zstd::bulk::compress(bytes, 1).unwrap();
    let idl = "module geometry_msgs { module msg { struct PoseStamped { \
        std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; }; }; };";
    let mut seeds = vec![
        ("mcap", mcap(None)),
        ("mcap", mcap(Some(mcap::Compression::Zstd))),
        ("mcap", mcap(Some(mcap::Compression::Lz4))),
        ("rosbag1", bag("none")),
        ("rosbag1", bag("bz2")),
        ("rosbag1", bag("lz4")),
        ("rosbag2", database(DatabaseWriter::create)),
        ("rosbag2", database(DatabaseWriter::create_old)),
        ("rtde", rtde()),
        ("rtde", rtde().iter().map(|&b| if b == b' ' { b',' } else { b }).collect()),
        ("zstd", zstd(&mcap(None))),
        ("zstd", zstd(&database(DatabaseWriter::create))),
        ("metadata", METADATA.to_vec()),
        ("ros2msg", message(POSE, testing::POSE_STAMPED.as_bytes(), &pose(7))),
        ("ros2idl", message(POSE, idl.as_bytes(), &pose(7))),
    ];
    for (target, type_name, schema, data) in encodings::seeds() {
        seeds.push((target, message(type_name, &schema, &data)));
    }
    seeds.extend(tables());
    seeds.extend(trajectories());
    seeds.extend(records());
    seeds
}

fn trajectories() -> [(&'static str, Vec<u8>); 3] {
    let tum = "# timestamp tx ty tz qx qy qz qw\n1.5e9 1 2 3 0.6 0 0 -0.8\n1500000000.01 1 2 3.5 0 0 0 1\n";
    let euroc = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n\
        1403715524907143168,1,2,3,1,0,0,0\n1403715524912143104,1,2,3.5,1,0,0,0\n";
    let kitti = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0.5 0 0 -1 0 0 1 0 2\n";
    [tum, euroc, kitti].map(|text| ("csv", text.as_bytes().to_vec()))
}

/// Records, a sheet of a workbook behind its strings, and a table behind its layout.
fn records() -> [(&'static str, Vec<u8>); 8] {
    let row = |n: u32| {
        format!("{{\"t\":{n},\"q\":[0.{n},1,2,3,4,5],\"pose\":{{\"x\":1e-3,\"mode\":\"a\"}}}}")
    };
    let rows: Vec<String> = (0..4).map(row).collect();
    let columns = "{\"fps\":30,\"t\":[0,1,2],\"q\":[[1,2,3,4],[1,2,3,5],[1,2,3,6]]}";
    let list = "- time: 0.0\n  q: [1, 2, 3, 4]\n  pose: {x: 1, y: 2, z: 3}\n- time: 0.1\n  q: &a [1, 2, 3, 5]\n";
    let documents = "stamp: {secs: 17, nsecs: 1}\nposition: [1, 2, 3, 4]\n---\nstamp: {secs: 17, nsecs: 2000000}\n\
        position: [1, 2, 3, 5]\n";
    let strings: &[u8] = b"<sst><si><t>time</t></si><si><t>q1</t></si></sst>";
    let sheet = b"<worksheet><sheetData><row r=\"1\"><c r=\"A1\" t=\"s\"><v>0</v></c><c r=\"B1\" t=\"s\"><v>1</v></c>\
        <c r=\"C1\" t=\"inlineStr\"><is><t>q2</t></is></c></row><row r=\"2\"><c r=\"A2\"><v>0</v></c><c r=\"B2\"><v>0.5</v>\
        </c><c r=\"C2\"><v>1</v></c></row><row r=\"3\"><c r=\"A3\"><v>0.1</v></c><c r=\"B3\"><v>0.6</v></c><c r=\"C3\"><v>2\
        </v></c></row></sheetData></worksheet>";
    let workbook = [&(strings.len() as u16).to_le_bytes(), strings, sheet].concat();
    let vectors = b"timestamp,q\n0.1,\"[1, 2, 3, 4]\"\n0.2,\"[1, 2, 3, 5]\"\n".to_vec();
    let layout: &[u8] = b"t:ms,q[2]:deg,qd[2],_,cmd.xyz,?";
    let table = b"1,2,3,4,5,a,7,8,9,1\n2,2,3,4,5,a,7,8,9,2\n3,2.5,3,4,5,a,7,8,9,3\n";
    [
        ("records", rows.join("\n").into_bytes()),
        ("records", format!("[{}]", rows.join(",")).into_bytes()),
        ("records", columns.into()),
        ("yaml", list.into()),
        ("yaml", documents.into()),
        ("xlsx", workbook),
        ("csv", vectors),
        ("columns", [&[layout.len() as u8], layout, table].concat()),
    ]
}

fn tables() -> Vec<(&'static str, Vec<u8>)> {
    let behind_length =
        |first: &[u8], rest: &[u8]| [&(first.len() as u16).to_le_bytes(), first, rest].concat();
    let npy = |shape: &str, numbers: usize| {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n");
        let data: Vec<u8> = (0..numbers).flat_map(|n| (0.01 * n as f64).to_le_bytes()).collect();
        table_writers::npy(&header, &data)
    };
    let metadata = br#"{"zarr_format":2,"shape":[20,6],"chunks":[20,6],"dtype":"<f8","compressor":null,"filters":null,"fill_value":0.0,"order":"C"}"#;
    let chunk: Vec<u8> = (0..120).flat_map(|n| f64::from(n).to_le_bytes()).collect();
    let info = br#"{"fps":30,"robot_type":"so100","features":{"observation.state":{"dtype":"float32","shape":[7],"names":["a","b","c","d","e","f","g"]}}}"#;
    let rows = "0.00,1,2,3,4,5,6\n0.01,1.5,2,3,4,5,6\n0.02,2,2,3,4,5,6\n".to_owned();
    let episode = table_writers::parquet(30, 2, parquet::basic::Compression::SNAPPY, |_| 7);
    let step = |n: u32| {
        let joints = (0..6).map(|joint| 0.1 * (n * joint) as f32).collect();
        table_writers::stores::example(&[
            ("joint_positions", joints),
            ("timestamp", vec![n as f32]),
        ])
    };
    vec![
        (
            "csv",
            format!("# a log\nt,q1,q2,q3,q4,q5,q6\ns,rad,rad,rad,rad,rad,rad\n{rows}").into_bytes(),
        ),
        ("csv", rows.replace(',', ";").replace('.', ",").into_bytes()),
        ("hdf5", table_writers::CHUNKED.to_vec()),
        ("lerobot", info.to_vec()),
        ("npy", table_writers::records(20)),
        ("npz", behind_length(&npy("(20,)", 20), &npy("(20, 6)", 120))),
        ("parquet", episode),
        ("rsi", (0..5).map(table_writers::stores::packet).collect::<String>().into_bytes()),
        ("tfrecord", (0..4).flat_map(|n| behind_length(&step(n), &[])).collect()),
        ("zarr", behind_length(metadata, &chunk)),
    ]
}

const WRITE: &str = "POSEAUDIT_WRITE_SEEDS";

#[test]
fn fuzzing_seeds_match_the_writers() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds");
    let temporary = tempfile::tempdir().unwrap();
    for (number, (target, bytes)) in all().into_iter().enumerate() {
        let path = folder.join(target).join(format!("{number:02}"));
        if std::env::var_os(WRITE).is_some() {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &bytes).unwrap();
        }
        let kept = fs::read(&path).unwrap();
        // Versions of a compressor or of SQLite may write different bytes.
        let made = temporary.path().join("log");
        fs::write(&made, &bytes).unwrap();
        let topics = |path: &Path| {
            let log =
                open(&[path.to_owned()], &ReadOptions { verify: true, ..ReadOptions::default() });
            log.map(|log| (log.topics, log.losses)).ok()
        };
        let same = kept == bytes || topics(&path).is_some_and(|kept| Some(kept) == topics(&made));
        assert!(same, "{}: set {WRITE}=1 to rewrite it", path.display());
    }
}
