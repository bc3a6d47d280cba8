//! Streams of different rates, and text as spreadsheets write it.

use std::io::Write;

use super::*;
use crate::TableCell;
use crate::tables::names;

/// An NPY array of float64 by rows.
fn array_of(shape: &[usize], number: impl Fn(usize) -> f64) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({sides}), }}\n");
    let count = shape.iter().product::<usize>();
    npy(&header, &(0..count).flat_map(|at| number(at).to_le_bytes()).collect::<Vec<u8>>())
}

fn npz(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    archive(arrays.iter().map(|(name, array)| (format!("{name}.npy"), array.clone())))
}

fn archive(members: impl IntoIterator<Item = (String, Vec<u8>)>) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in members {
        let options = zip::write::SimpleFileOptions::default();
        archive.start_file(name, options).expect("a member");
        archive.write_all(&content).expect("written");
    }
    archive.finish().expect("an archive").into_inner()
}

/// A workbook with one sheet. Cells of the column with this letter and the row with this number; without a value, a
/// cell only has a style.
fn workbook(cells: &[(char, usize, Option<String>)]) -> Vec<u8> {
    let last = cells.iter().map(|(_, row, _)| *row).max().unwrap_or(0);
    let row = |row: usize| -> String {
        let mut own: Vec<_> = cells.iter().filter(|(_, at, _)| *at == row).collect();
        own.sort();
        let cell = |(column, row, value): &(char, usize, Option<String>)| match value {
            Some(text) => {
                format!("<c r=\"{column}{row}\" t=\"inlineStr\"><is><t>{text}</t></is></c>")
            }
            None => format!("<c r=\"{column}{row}\" s=\"0\"/>"),
        };
        let own: String = own.into_iter().map(cell).collect();
        format!("<row r=\"{row}\">{own}</row>")
    };
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let package = "http://schemas.openxmlformats.org/package/2006";
    let rows: String = (1..=last).map(row).collect();
    let members = [
        ("[Content_Types].xml", format!("<Types xmlns=\"{package}/content-types\"/>")),
        (
            "_rels/.rels",
            format!(
                "<Relationships xmlns=\"{package}/relationships\"><Relationship Id=\"rId1\" \
                Type=\"{office}/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            format!(
                "<Relationships xmlns=\"{package}/relationships\"><Relationship Id=\"rId1\" \
                Type=\"{office}/worksheet\" Target=\"worksheets/sheet1.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{main}\" xmlns:r=\"{office}\"><sheets>\
                <sheet name=\"run\" sheetId=\"1\" r:id=\"rId1\"/></sheets></workbook>"
            ),
        ),
        (
            "xl/worksheets/sheet1.xml",
            format!("<worksheet xmlns=\"{main}\"><sheetData>{rows}</sheetData></worksheet>"),
        ),
    ];
    archive(members.map(|(name, text)| (name.to_owned(), text.into_bytes())))
}

/// Names, then a time and six joints in each row; the last column only has a number in row 9.
#[test]
fn cells_beside_the_table_of_a_sheet_are_noted() {
    let names = ["t", "q1", "q2", "q3", "q4", "q5", "q6", "event"];
    let mut table: Vec<(char, usize, Option<String>)> =
        ('A'..='H').zip(names).map(|(column, name)| (column, 1, Some(name.to_owned()))).collect();
    for row in 2..40 {
        table.extend(('A'..='G').zip(1..).map(|(column, at)| {
            (column, row, Some(format!("{:.2}", 0.01 * row as f64 * f64::from(at))))
        }));
    }
    table.push(('H', 9, Some("7".to_owned())));
    let text = |own: &str| Some(own.to_owned());
    for (beside, note) in [
        (vec![], None),
        (vec![('K', 3, None), ('L', 4, None)], None),
        (vec![('K', 3, text("by hand")), ('K', 4, text("1.25"))], Some("2, from line 3 on")),
        (vec![('J', 1, text("by hand"))], Some("1, from line 1 on")),
        (vec![('I', 9, text("start"))], Some("1, from line 9 on")),
    ] {
        let log = plain(&workbook(&[table.clone(), beside].concat()));
        assert_eq!(joints(&log, "q").1.len(), 38);
        assert!(log.topics.iter().any(|topic| topic.name == "event"));
        assert!(log.losses.is_empty(), "{:?}", log.losses);
        let notes: Vec<&str> = log.notes.iter().map(|note| note.what.as_str()).collect();
        let found = notes.iter().find(|note| note.contains("beside")).copied();
        let expected =
            note.map(|own| format!("sheet 'run': cells beside the table are not used: {own}"));
        assert_eq!(found, expected.as_deref(), "{notes:?}");
    }
}

/// No time: it does not increase.
fn wave(at: usize) -> f64 {
    (0.01 * at as f64).sin()
}

/// Joint states at 100 Hz and poses at 40 Hz, each with its times.
fn two_rates() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("t_joint", array_of(&[500], |row| 5.0 + 0.01 * row as f64)),
        ("q", array_of(&[500, 6], wave)),
        ("t_pose", array_of(&[200], |row| 5.004 + 0.025 * row as f64)),
        ("tcp_pose", array_of(&[200, 6], wave)),
    ]
}

#[test]
fn arrays_with_times_of_their_own_are_streams() {
    let log = plain(&npz(&two_rates()));
    assert_eq!(joints(&log, "q").1.len(), 500);
    assert_eq!(stamps(&log, "q")[1], 5_010_000_000);
    assert_eq!(array(&log, "tcp_pose").1.len(), 200 * 6);
    assert_eq!(stamps(&log, "tcp_pose")[1], 5_029_000_000);
    assert!(log.losses.is_empty(), "{:?}", log.losses);
    // Without its times, nothing shows when the poses were measured.
    let mut arrays = two_rates();
    arrays.remove(2);
    let log = plain(&npz(&arrays));
    assert!(topic(&log, "tcp_pose").columns.is_none());
}

#[test]
fn transposed_arrays_of_two_rates_are_turned() {
    let arrays = [
        ("tq", array_of(&[1, 500], |row| 0.01 * row as f64)),
        ("q", array_of(&[7, 500], wave)),
        ("tp", array_of(&[1, 200], |row| 0.025 * row as f64)),
        ("tcp_pose", array_of(&[6, 200], wave)),
    ];
    let log = plain(&npz(&arrays));
    assert_eq!(joints(&log, "q").1[1][..2], [wave(1), wave(501)]);
    assert_eq!(array(&log, "tcp_pose").1[..2], [wave(0), wave(200)]);
}

#[test]
fn scalars_give_the_rate_or_else_the_period_of_arrays() {
    let scalar = |name: &'static str, value: f64| (name, array_of(&[], |_| value));
    let q = || ("q", array_of(&[300, 6], wave));
    for (scalars, period_ns) in [
        (vec![scalar("dt", 0.004)], 4_000_000),
        (vec![scalar("fps", 50.0), scalar("dt", 0.004)], 20_000_000),
        (vec![scalar("dt", 0.004), scalar("fps", 50.0)], 20_000_000),
    ] {
        let log = plain(&npz(&[vec![q()], scalars].concat()));
        let stamps = stamps(&log, "q");
        assert_eq!(stamps[1] - stamps[0], period_ns);
    }
    // A period of a second or more may be that of a motion.
    let archive = npz(&[q(), scalar("dt", 2.0)]);
    let error = read(&archive, ColumnSettings::default()).expect_err("no times").to_string();
    assert!(error.contains("no column holds times"), "{error}");
}

#[test]
fn config_columns_may_be_of_either_rate() {
    let selector = |text: &str| vec![text.parse().expect("a selector")];
    let columns = ColumnSettings {
        time: Some("t_joint".to_owned()),
        joints: selector("q"),
        pose: selector("tcp_pose"),
        ..ColumnSettings::default()
    };
    let log = read(&npz(&two_rates()), columns).expect("a log");
    assert_eq!(joints(&log, "joints").1.len(), 500);
    assert_eq!(array(&log, "pose").1.len(), 200 * 6);
    let absent = ColumnSettings { joints: selector("p"), ..ColumnSettings::default() };
    assert!(read(&npz(&two_rates()), absent).is_err());
}

/// Joints every 10 ms and poses every 25 ms, never in one row.
fn sparse_csv() -> String {
    let mut rows: Vec<(f64, String)> = Vec::new();
    for k in 0..200 {
        let q: Vec<String> =
            (0..6).map(|joint| format!("{:.4}", 1e-3 * f64::from(k + joint))).collect();
        rows.push((0.01 * f64::from(k), format!("{},,,,,,", q.join(","))));
    }
    for k in 0..80 {
        let pose: Vec<String> =
            (0..6).map(|part| format!("{:.4}", 1e-3 * f64::from(k + part))).collect();
        rows.push((0.025 * f64::from(k) + 0.003, format!(",,,,,,{}", pose.join(","))));
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let lines = rows.iter().map(|(t_s, cells)| format!("{t_s:.3},{cells}\n"));
    format!("time,q1,q2,q3,q4,q5,q6,x,y,z,rx,ry,rz\n{}", lines.collect::<String>())
}

#[test]
fn empty_cells_of_another_rate_are_no_samples() {
    let log = plain(sparse_csv().as_bytes());
    let Some(Columns::Joints(own)) = &topic(&log, "q").columns else { panic!("no joints") };
    assert_eq!((own.times.len(), own.not_finite), (200, 0));
    assert!(own.unusable.iter().all(|count| *count == 0), "{:?}", own.unusable);
    let Some(Columns::Array(pose)) = &topic(&log, "pose").columns else { panic!("no pose") };
    assert_eq!((pose.times.len(), pose.not_finite), (80, 0));
    let why = topic(&log, "pose").read_as.clone().expect("a reason");
    assert!(why.ends_with("; in 80 of 280 rows"), "{why}");
    assert!(log.losses.is_empty(), "{:?}", log.losses);
}

#[test]
fn empty_cells_of_a_tracker_that_loses_its_target_are_unusable_samples() {
    let row = |k: usize| {
        let pose = if (40..60).contains(&k) { ",,,,," } else { "1,2,3,4,5,6" };
        format!("{:.2},0,1,2,3,4,{},{pose}\n", 0.01 * k as f64, 1e-3 * k as f64)
    };
    let text = (0..200).map(row).collect::<String>();
    let log = plain(format!("time,q1,q2,q3,q4,q5,q6,x,y,z,rx,ry,rz\n{text}").as_bytes());
    let Some(Columns::Array(pose)) = &topic(&log, "pose").columns else { panic!("no pose") };
    assert_eq!((pose.times.len(), pose.not_finite), (180, 20));
}

#[test]
fn text_of_a_spreadsheet_is_read_in_its_encoding() {
    let header = "Zeit;A1 [°];A2 [°];A3 [°];A4 [°];A5 [°];A6 [°]\r\n";
    let row = |k: u32| {
        format!("{};{k};1;2;3;4;5\r\n", format!("{:.2}", 0.01 * f64::from(k)).replace('.', ","))
    };
    let text = header.to_owned() + &(0..50).map(row).collect::<String>();
    let utf16: Vec<u8> =
        [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let single: Vec<u8> = text.chars().map(|c| u32::from(c) as u8).collect();
    for bytes in [text.into_bytes(), utf16, single] {
        let log = plain(&bytes);
        let (_, rows) = joints(&log, "a");
        assert!((rows[10][0] - 10f64.to_radians()).abs() < 1e-12, "{:?}", rows[10]);
        assert_eq!(stamps(&log, "a")[10], 100_000_000);
    }
}

#[test]
fn files_with_the_same_counters_are_one_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, columns: &str, cells: &str| {
        let row = |k: usize| format!("{},{k},{cells}\n", 10 * k as u64 + 1_700_000_000_000);
        let text = (0..100).map(row).collect::<String>();
        let path = folder.path().join(name);
        fs::write(&path, format!("time_ms,seq,{columns}\n{text}")).expect("a file");
        path
    };
    let paths = [
        file("joints.csv", "q1,q2,q3,q4,q5,q6", "0.1,0.2,0.3,0.4,0.5,0.6"),
        file("tool.csv", "x,y,z,qx,qy,qz,qw", "0.1,0.2,0.3,0,0,0,1"),
    ];
    let log = open(&paths, &ReadOptions::default()).expect("a log");
    let received =
        |name: &str| topic(&log, name).columns.as_ref().expect("columns").times()[0].log[0];
    assert_eq!(received("q"), received("tool"));
    // The same joints again are the next episode.
    let again = file("again.csv", "q1,q2,q3,q4,q5,q6", "0.1,0.2,0.3,0.4,0.5,0.7");
    let log = open(&[paths[0].clone(), again], &ReadOptions::default()).expect("a log");
    let times = topic(&log, "q").columns.as_ref().expect("columns").times()[0].log.clone();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn columns_have_the_times_that_are_named_like_them() {
    let late_s = 0.017;
    let arrays = [
        ("joint_time", array_of(&[200], |row| 5.0 + 0.01 * row as f64)),
        ("joint_position", array_of(&[200, 6], wave)),
        ("tcp_time", array_of(&[200], |row| 5.0 + late_s + 0.01 * row as f64)),
        ("tcp_pose", array_of(&[200, 6], wave)),
    ];
    let log = plain(&npz(&arrays));
    assert_eq!(stamps(&log, "joint_position")[0], 5_000_000_000);
    assert_eq!(stamps(&log, "tcp_pose")[0], 5_017_000_000);
}

#[test]
fn blocks_of_columns_with_times_of_their_own_are_streams() {
    let joints_of = |k: usize| format!("{:.2},0,1,2,3,4,{}", 0.01 * k as f64, 1e-3 * k as f64);
    let pose_of = |k: usize| match k {
        0..80 => format!("{:.3},1,2,3,0,0,{}", 0.025 * k as f64 + 0.004, 1e-3 * k as f64),
        _ => ",,,,,,".to_owned(),
    };
    let rows = (0..200).map(|k| format!("{},{}\n", joints_of(k), pose_of(k)));
    let header = "time_joints,q1,q2,q3,q4,q5,q6,time_pose,x,y,z,rx,ry,rz\n";
    let log = plain((header.to_owned() + &rows.collect::<String>()).as_bytes());
    assert_eq!(joints(&log, "q").1.len(), 200);
    assert_eq!(stamps(&log, "pose").len(), 80);
    assert_eq!(stamps(&log, "pose")[2], 54_000_000);
    let received = &topic(&log, "pose").columns.as_ref().expect("columns").times()[0].log;
    assert_eq!(received[2], 54_000_000);
}

#[test]
fn records_of_several_topics_are_streams() {
    let joints_of = |k: usize| {
        format!(
            r#"{{"topic": "/joint_states", "stamp": {:.2}, "position": [0,1,2,3,4,{}]}}"#,
            0.01 * k as f64,
            1e-3 * k as f64
        )
    };
    let pose_of = |k: usize| {
        format!(
            r#"{{"topic": "/tcp", "stamp": {:.3}, "pose": [1,2,3,0,0,{}]}}"#,
            0.01 * k as f64 + 0.004,
            1e-3 * k as f64
        )
    };
    let lines = (0..100).map(|k| format!("{}\n{}\n", joints_of(k), pose_of(k)));
    let log = plain(lines.collect::<String>().as_bytes());
    assert_eq!(joints(&log, "joint_states.position").1.len(), 100);
    assert_eq!(array(&log, "tcp.pose").1.len(), 600);
    // One topic is part of no name.
    let lines = (0..100).map(|k| format!("{}\n", joints_of(k).replace("position", "q")));
    assert_eq!(joints(&plain(lines.collect::<String>().as_bytes()), "q").1.len(), 100);
}

#[test]
fn lists_of_different_lengths_in_a_document_are_streams() {
    let list = |count: usize, number: &dyn Fn(usize) -> String| {
        format!("[{}]", (0..count).map(number).collect::<Vec<_>>().join(","))
    };
    let text = format!(
        r#"{{"joint_time": {}, "joint_positions": {}, "tcp_time": {}, "tcp_pose": {}}}"#,
        list(500, &|row| format!("{:.2}", 0.01 * row as f64)),
        list(500, &|row| format!("[0,1,2,3,4,{}]", 1e-3 * row as f64)),
        list(200, &|row| format!("{:.3}", 0.025 * row as f64)),
        list(200, &|row| format!("[1,2,3,0,0,{}]", 1e-3 * row as f64)),
    );
    let log = plain(text.as_bytes());
    assert_eq!(joints(&log, "joint_positions").1.len(), 500);
    assert_eq!(array(&log, "tcp_pose").1.len(), 1200);
    assert_eq!(stamps(&log, "tcp_pose")[1], 25_000_000);
}

/// Rows of six joints with the text of their times.
fn rows_at(time: impl Fn(usize) -> String) -> String {
    let row = |row: usize| {
        let q: Vec<String> = (0..6).map(|joint| format!("{:.6}", wave(row + 40 * joint))).collect();
        format!("\n{},{}", time(row), q.join(","))
    };
    "Time,q1,q2,q3,q4,q5,q6".to_owned() + &(0..60).map(row).collect::<String>()
}

#[test]
fn times_of_day_continue_after_the_hour_and_after_midnight() {
    let seconds = |row: usize| 3599.5 + 0.02 * row as f64;
    let minutes = |row: usize| {
        let time = seconds(row) % 3600.0;
        format!("{:02}:{:07.4}", (time / 60.0) as u32, time % 60.0)
    };
    let hours = |row: usize| {
        let time = (82_800.0 + seconds(row)) % 86_400.0;
        let [hour, minute] = [time / 3600.0, time % 3600.0 / 60.0].map(|part| part as u32);
        format!("{hour:02}:{minute:02}:{:06.3}", time % 60.0)
    };
    for text in [rows_at(minutes), rows_at(hours)] {
        let log = plain(text.as_bytes());
        let stamps = stamps(&log, "q");
        let steps: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| (step - 20_000_000).abs() < 1_000_000), "{steps:?}");
    }
    // Numbers of seconds that fall are another episode, or are no times.
    let restarted = |row: usize| format!("{:.2}", 0.02 * (row % 30) as f64 + 3000.0);
    let stamps = stamps(&plain(rows_at(restarted).as_bytes()), "q");
    assert!(stamps[30] < stamps[29], "{stamps:?}");
}

#[test]
fn columns_of_a_table_without_times_are_read_at_an_assumed_rate() {
    let assumed = ColumnSettings { assumed_rate_hz: Some(50.0), ..ColumnSettings::default() };
    let arrays = [("q", array_of(&[100, 6], wave)), ("tcp_pose", array_of(&[100, 6], wave))];
    let log = read(&npz(&arrays), assumed.clone()).expect("a log");
    assert!(log.tables[0].lacks_times && log.tables[0].rate_hz.is_none());
    assert_eq!(joints(&log, "q").1.len(), 100);
    // Times are not replaced.
    let log = read(&npz(&two_rates()), assumed).expect("a log");
    assert!(log.tables.iter().all(|table| !table.lacks_times));
    assert_eq!(stamps(&log, "q")[1], 5_010_000_000);
}

#[test]
fn velocities_are_found_by_the_names_of_positions() {
    let row = |row: usize| {
        let list = |phase: usize| -> Vec<String> {
            (0..8).map(|joint| format!("{:.5e}", wave(row + phase + 30 * joint))).collect()
        };
        format!("\n{},\"[{}]\",\"[{}]\"", 0.02 * row as f64, list(0).join(" "), list(9).join(" "))
    };
    let text = "Time,Position,Velocity".to_owned() + &(0..60).map(row).collect::<String>();
    let log = plain(text.as_bytes());
    let cell = |joint: usize| topic(&log, &format!("Position[{joint}]")).cells[0].clone();
    let positions: Vec<TableCell> = (1..8).map(cell).collect();
    let found = log.tables[0].velocities_of(&positions);
    let found: Vec<&str> = found.iter().map(|cell| cell.name.as_str()).collect();
    let expected: Vec<String> = (1..8).map(|joint| format!("Velocity[{joint}]")).collect();
    assert_eq!(found, expected);
}

#[test]
fn a_letter_before_a_number_is_no_side() {
    let prefix = |name: &str| names::arm_prefix(&names::split_words(name));
    for (name, expected) in [
        ("Fair_R0.055_T10_jointPosition", ""),
        ("arm_r_joint", "right_"),
        ("left_joint", "left_"),
        ("R2_left_q", "left_"),
    ] {
        assert_eq!(prefix(name), expected, "{name}");
    }
}

#[test]
fn stamps_of_the_robot_precede_those_of_images() {
    let mut text = "image_timestamp,robot_timestamp,q1,q2,q3,q4,q5,q6".to_owned();
    for row in 0..100 {
        let (image, robot) = (5.0 + 0.01 * row as f64, 5.037 + 0.02 * (row / 2) as f64);
        text += &format!("\n{image},{robot}");
        (0..6).for_each(|joint| text += &format!(",{}", wave(10 * (row / 2) + joint)));
    }
    assert_eq!(stamps(&plain(text.as_bytes()), "q")[0], 5_037_000_000);
}

#[test]
fn rows_are_received_in_their_order_where_the_clock_steps_back() {
    let row = |row: usize| {
        let q: Vec<String> = (0..6).map(|joint| format!("{:.6}", wave(row + 10 * joint))).collect();
        format!("{:.2},{}\n", 0.01 * (row % 100) as f64, q.join(","))
    };
    let rows: String = (0..300).map(row).collect();
    let log = plain(format!("time,q1,q2,q3,q4,q5,q6\n{rows}").as_bytes());
    let columns = log.topics.iter().find_map(|topic| topic.columns.as_ref()).expect("columns");
    let times = columns.times()[0];
    assert_eq!([0, 99, 100, 299].map(|row| times.header[row] / 10_000_000), [0, 99, 0, 99]);
    assert!(times.log.is_sorted());
    let span_ns = times.log[299] - times.log[0];
    assert!((span_ns - 2_970_000_000).abs() < 10, "{span_ns}");
}

#[test]
fn joints_in_both_units_keep_their_own() {
    let row = |row: usize| {
        let rad: Vec<f64> = (0..6).map(|joint| 2.0 * wave(row + 10 * joint)).collect();
        let deg: Vec<f64> = rad.iter().map(|q| q.to_degrees()).collect();
        let t_s = 0.01 * row as f64;
        format!("{{\"time\": {t_s:.2}, \"joints_deg\": {deg:?}, \"joints_rad\": {rad:?}}}\n")
    };
    let log = plain((0..300).map(row).collect::<String>().as_bytes());
    for (name, is_in_degrees) in [("joints_deg", true), ("joints_rad", false)] {
        let Some(Columns::Joints(joints)) = &topic(&log, name).columns else { panic!("{name}") };
        assert_eq!(joints.converted_from_degrees, is_in_degrees, "{name}");
        assert!((joints.joints[0].position[299] - 2.0 * wave(299)).abs() < 1e-9, "{name}");
    }
}

#[test]
fn rows_that_name_their_stream_are_split() {
    let rows = || (0..200).map(|row| (row, ["left", "right"][row % 2]));
    let numbers = |row: usize| -> Vec<f64> {
        (0..6).map(|at| wave(4 * row + 50 * at) + (row % 2) as f64).collect()
    };
    let text = |row: usize| numbers(row).iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let stamp = |row: usize| 0.01 * (row / 2) as f64;
    let names = "time,arm,q1,q2,q3,q4,q5,q6\n";
    let csv_of = |label: &dyn Fn(usize, &str) -> String| {
        let line = |(row, arm)| format!("{},{},{}\n", stamp(row), label(row, arm), text(row));
        names.to_owned() + &rows().map(line).collect::<String>()
    };
    let records: String = rows()
        .map(|(row, arm)| {
            format!("{{\"time\":{},\"arm\":\"{arm}\",\"q\":[{}]}}\n", stamp(row), text(row))
        })
        .collect();
    for (log, streams, unlabelled) in [
        (csv_of(&|_, arm| arm.to_owned()), ["left/q", "right/q"], 0),
        (csv_of(&|row, _| (row % 2 + 2).to_string()), ["arm_2/q", "arm_3/q"], 0),
        // No row is dropped.
        (
            csv_of(&|row, arm| if row < 10 { String::new() } else { arm.to_owned() }),
            ["left/q", "right/q"],
            10,
        ),
        (records, ["left/q", "right/q"], 0),
    ] {
        let log = plain(log.as_bytes());
        for (parity, stream) in streams.into_iter().enumerate() {
            let (_, own) = joints(&log, stream);
            assert_eq!(own.len(), 100 - unlabelled / 2);
            assert_eq!(own[0], numbers(unlabelled + parity));
        }
        assert_eq!(topic(&log, "arm").read_as.as_deref(), Some("names the stream of each row"));
        if unlabelled > 0 {
            assert_eq!(joints(&log, "q").1.len(), unlabelled);
        }
    }
}

#[test]
fn times_without_a_telling_name_may_repeat_and_be_uneven() {
    // Steps of 2 to 4 ms with pauses, rounded to ms.
    let stamps: Vec<f64> = (0..1000)
        .scan(0.0, |t_s, row| {
            let step_s = [0.002, 0.003, 0.004, 0.003, 0.0005, 0.02, 0.0075][row * row % 97 % 7];
            *t_s += step_s;
            Some(*t_s)
        })
        .collect();
    let measured = |row: usize| (1e3 * stamps[row]).round() * 1e-3;
    let even = |row: usize| 0.004 * (row - usize::from(row % 40 == 39)) as f64;
    let q = |row: usize, at: usize| (2.0 * stamps[row] + at as f64).sin();
    let qd = |row: usize, at: usize| 2.0 * (2.0 * stamps[row] + at as f64).cos();
    let log_of = |stamp: &dyn Fn(usize) -> f64, factor: f64, has_velocities: bool| {
        let names: Vec<String> =
            ["q", "qd"].iter().flat_map(|of| (1..=6).map(move |at| format!("{of}{at}"))).collect();
        let count = if has_velocities { 12 } else { 6 };
        let mut text = format!("t_measured,{}\n", names[..count].join(","));
        for row in 0..1000 {
            let numbers = (0..6).map(|at| q(row, at)).chain((0..6).map(|at| factor * qd(row, at)));
            let numbers: Vec<String> = numbers.take(count).map(|own| format!("{own:.7}")).collect();
            text += &format!("{:.3},{}\n", stamp(row), numbers.join(","));
        }
        read(text.as_bytes(), ColumnSettings::default())
    };
    let is_time = |log: &Log| log.time_column.as_deref() == Some("t_measured");
    let confirmed = log_of(&measured, 1.0, true).expect("a log");
    assert!(is_time(&confirmed));
    let note = &confirmed.notes[0].what;
    assert!(note.ends_with("recorded velocities confirm them"), "{note}");
    // One of 40 stamps is that of the row before.
    let repeated = log_of(&even, 1.0, false).expect("a log");
    assert!(is_time(&repeated));
    // Velocities of another time, or none.
    assert!(log_of(&measured, 0.5, true).is_err());
    assert!(log_of(&measured, 1.0, false).is_err());
}
