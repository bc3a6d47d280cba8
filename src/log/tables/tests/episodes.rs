//! Episodes of one row group, read one after the other.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use ::parquet::data_type::{DoubleType, FloatType, Int64Type};
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;

use crate::{ReadOptions, open};

const ROWS: [usize; 5] = [60, 90, 40, 120, 70];

/// Pages end within an episode.
fn row_group_of_episodes() -> Vec<u8> {
    let schema = "message rows {
        optional group observation.state (LIST) { repeated group list { optional float element; } }
        required double timestamp; required int64 episode_index; }";
    let schema = Arc::new(parse_message_type(schema).expect("a schema"));
    let properties = WriterProperties::builder()
        .set_data_page_row_count_limit(50)
        .set_write_batch_size(10)
        .set_dictionary_enabled(false);
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::new(properties.build()))
        .expect("a writer");
    let mut group = file.next_row_group().expect("a group");
    let rows = ROWS
        .iter()
        .enumerate()
        .flat_map(|(episode, rows)| (0..*rows).map(move |row| (episode, row)));
    let rows: Vec<(usize, usize)> = rows.collect();
    let mut states = group.next_column().expect("a column").expect("another");
    let (mut values, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
    for (episode, row) in &rows {
        for part in 0..6 {
            // One number is missing.
            let is_there = (*episode, *row, part) != (1, 3, 2);
            values.extend(is_there.then_some((episode * 1000 + row * 10 + part) as f32));
            definitions.push(if is_there { 3 } else { 2 });
            repetitions.push(i16::from(part > 0));
        }
    }
    states
        .typed::<FloatType>()
        .write_batch(&values, Some(&definitions), Some(&repetitions))
        .expect("lists");
    states.close().expect("a column");
    let mut times = group.next_column().expect("a column").expect("another");
    let stamps: Vec<f64> = rows.iter().map(|(_, row)| *row as f64 / 30.0).collect();
    times.typed::<DoubleType>().write_batch(&stamps, None, None).expect("times");
    times.close().expect("a column");
    let mut index = group.next_column().expect("a column").expect("another");
    let episodes: Vec<i64> = rows.iter().map(|(episode, _)| *episode as i64).collect();
    index.typed::<Int64Type>().write_batch(&episodes, None, None).expect("episodes");
    index.close().expect("a column");
    group.close().expect("a group");
    file.close().expect("a file");
    bytes
}

/// Content of an episode, or the error.
fn read(file: &Path, episode: usize) -> String {
    let path = format!("{}#{episode}", file.display());
    let log = open(&[path.into()], &ReadOptions::default());
    let log = log.map(|log| (log.topics, log.losses, log.notes));
    format!("{log:?}").replace(&file.display().to_string(), "FILE")
}

#[test]
fn an_episode_after_others_is_the_same_as_alone() {
    const BYTES_BETWEEN_DAMAGES: usize = 701;
    let intact = row_group_of_episodes();
    let damaged = (4..intact.len()).step_by(BYTES_BETWEEN_DAMAGES).map(|at| {
        let mut bytes = intact.clone();
        bytes[at..(at + 8).min(intact.len())].fill(0xff);
        bytes
    });
    let folder = tempfile::tempdir().expect("a folder");
    for (file, bytes) in std::iter::once(intact.clone()).chain(damaged).enumerate() {
        let write = |name: String| {
            let own = folder.path().join(format!("{file}-{name}"));
            fs::create_dir(&own).expect("a folder");
            fs::write(own.join("run.parquet"), &bytes).expect("a file");
            own.join("run.parquet")
        };
        let shared = write("shared".to_owned());
        for (turn, episode) in [0, 1, 2, 3, 1, 3, 4].into_iter().enumerate() {
            let alone = read(&write(format!("alone-{turn}")), episode);
            assert_eq!(read(&shared, episode), alone, "file {file}, episode {episode}");
            assert!(file > 0 || alone.starts_with("Ok"), "{alone}");
        }
    }
}
