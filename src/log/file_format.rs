//! Identifies the format of a file from its first bytes.

use super::rtde;
use super::tables::{self, HDF5_MAGIC, NPY_MAGIC, TableFormat};
use super::unpack::ZSTD_MAGIC;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum FileFormat {
    Mcap,
    RosBag1,
    Sqlite,
    Zstd,
    /// Table whose first line names RTDE fields.
    Rtde,
    Table(TableFormat),
    Known {
        /// Name with article.
        looks: &'static str,
        /// Suggested action.
        instead: &'static str,
    },
    Unknown {
        looks: &'static str,
    },
}

const TO_MCAP: &str = "convert it to MCAP first";
const UNPACK: &str = "unpack it first";

const UNSUPPORTED_FORMATS: &[(&[u8], &str, &str)] = &[
    (b"#ROSBAG", "a ROS 1 bag of a version other than 2.0", "convert it with `rosbag fix` first"),
    (b"\x89MCAP", "an MCAP file of a version other than 0", "write it as MCAP version 0"),
    (b"ULog\x01\x12\x35", "a PX4 ULog", TO_MCAP),
    (b"RRF", "a Rerun recording", "audit the log that it was made from"),
    (b"\x04\x22\x4d\x18", "an lz4 archive", UNPACK),
    (b"\x1f\x8b", "a gzip archive", UNPACK),
    (
        b"version https://git-lfs",
        "a Git LFS pointer without the file's content",
        "fetch it with `git lfs pull`",
    ),
    (ZIP_MAGIC, "a zip archive", UNPACK),
    (b"\xd0\xcf\x11\xe0", "an Office file in the format before 2007", "save it as .xlsx or CSV"),
];

const SUPPORTED_FORMATS: &[(&[u8], FileFormat)] = &[
    (b"#ROSBAG V2.0\n", FileFormat::RosBag1),
    (b"SQLite format 3\0", FileFormat::Sqlite),
    (ZSTD_MAGIC, FileFormat::Zstd),
    (b"PAR1", FileFormat::Table(TableFormat::Parquet)),
    (HDF5_MAGIC, FileFormat::Table(TableFormat::Hdf5)),
    (tables::MATLAB_MAGIC, FileFormat::Table(TableFormat::Matlab)),
    (NPY_MAGIC, FileFormat::Table(TableFormat::Npy)),
];

const ZIP_MAGIC: &[u8] = b"PK\x03\x04";
/// Sizes of the block before HDF5, up to the bytes read to detect a format.
const HDF5_USER_BLOCKS: [usize; 3] = [512, 1024, 2048];
const PICKLE_PROTOCOLS: std::ops::RangeInclusive<u8> = 2..=5;
const FROM_PICKLE: &str = "reading one can run any program, so load it in Python if you trust it, and save its arrays \
     with numpy.savez or pandas.DataFrame.to_csv";
/// Offset of the first member's name.
const ZIP_NAME: usize = 30;

/// Bytes examined for an empty file and for packets.
const GLANCE_BYTES: usize = 4096;

pub(super) fn detect_format(bytes: &[u8]) -> FileFormat {
    if bytes.starts_with(mcap::MAGIC) {
        return FileFormat::Mcap;
    }
    if let Some(&(_, kind)) = SUPPORTED_FORMATS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return kind;
    }
    if mcap::MAGIC.starts_with(bytes) {
        return FileFormat::Unknown { looks: "an MCAP file truncated within its first 8 bytes" };
    }
    if is_npz(bytes) {
        return FileFormat::Table(TableFormat::Npz);
    }
    if bytes.starts_with(ZIP_MAGIC) && tables::is_zip_store(bytes) {
        return FileFormat::Table(TableFormat::Zarr);
    }
    if tables::has_record(bytes) {
        return FileFormat::Table(TableFormat::TfRecord);
    }
    if bytes.starts_with(ZIP_MAGIC) && tables::is_workbook(bytes) {
        return FileFormat::Table(TableFormat::Xlsx);
    }
    // MATLAB 7.3 writes 512 bytes of its own before HDF5.
    let has_hdf5 = |at: usize| bytes.get(at..).is_some_and(|rest| rest.starts_with(HDF5_MAGIC));
    if HDF5_USER_BLOCKS.into_iter().any(has_hdf5) {
        return FileFormat::Table(TableFormat::Hdf5);
    }
    if matches!(bytes, [0x80, protocol, ..] if PICKLE_PROTOCOLS.contains(protocol)) {
        return FileFormat::Known { looks: "a Python pickle", instead: FROM_PICKLE };
    }
    let known = UNSUPPORTED_FORMATS.iter().find(|(magic, ..)| bytes.starts_with(magic));
    if let Some(&(_, looks, instead)) = known {
        return FileFormat::Known { looks, instead };
    }
    let glance = &bytes[..bytes.len().min(GLANCE_BYTES)];
    match () {
        () if glance.iter().all(|&byte| byte == 0) => {
            FileFormat::Unknown { looks: "a file of zeros" }
        }
        () if tables::is_text(bytes) => detect_text(bytes, glance),
        () => FileFormat::Unknown { looks: "unknown binary data" },
    }
}

fn detect_text(bytes: &[u8], glance: &[u8]) -> FileFormat {
    match () {
        () if rtde::has_header(bytes) => FileFormat::Rtde,
        () if tables::looks_like_json(bytes) => FileFormat::Table(TableFormat::Json),
        () if tables::has_packet(glance) => FileFormat::Table(TableFormat::Rsi),
        () if let Some(format) = tables::detect_trajectory(bytes) => FileFormat::Table(format),
        () if tables::is_list_of_times(bytes) => FileFormat::Table(TableFormat::Times),
        () if tables::is_yaml_list(bytes) || tables::is_nested_yaml(bytes) => {
            FileFormat::Table(TableFormat::Yaml)
        }
        () if tables::is_table(bytes) => FileFormat::Table(TableFormat::Csv),
        () if tables::looks_like_yaml(bytes) => FileFormat::Table(TableFormat::Yaml),
        () if tables::is_table_of_text(bytes) => {
            FileFormat::Unknown { looks: "a table of text, not of numbers" }
        }
        () if tables::is_header_alone(bytes) => FileFormat::Known {
            looks: "a table with column names and no rows",
            instead: "check whether the recorder wrote its rows",
        },
        () if tables::is_list_of_numbers(bytes) => FileFormat::Known {
            looks: "a list with one number per line",
            instead: "put the columns of one run side by side, as in \
                      `paste -d, time.txt joint1.txt joint2.txt > run.csv`",
        },
        () if tables::is_list_of_pairs(bytes) => FileFormat::Known {
            looks: "a table with one number besides its times",
            instead: "join the tables of one run, so that each joint is a column",
        },
        () => FileFormat::Unknown { looks: "text" },
    }
}

fn is_npz(bytes: &[u8]) -> bool {
    let length = bytes.get(26..28).map(|two| usize::from(two[0]) | usize::from(two[1]) << 8);
    let name = length.and_then(|length| bytes.get(ZIP_NAME..ZIP_NAME + length));
    bytes.starts_with(ZIP_MAGIC) && name.is_some_and(|name| name.ends_with(b".npy"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_may_end_within_a_character() {
        assert_eq!(
            detect_format("Grüße, 1.0\nü".as_bytes()),
            FileFormat::Unknown { looks: "text" }
        );
        assert_eq!(detect_format(b"Gr\xc3"), FileFormat::Unknown { looks: "text" });
        assert_eq!(
            detect_format(b"Gr\xc3\x01"),
            FileFormat::Unknown { looks: "unknown binary data" }
        );
    }

    #[test]
    fn an_error_names_another_mcap_version() {
        assert!(matches!(detect_format(b"\x89MCAP9\r\n...."), FileFormat::Known { .. }));
    }
}
