//! Logs for the fleet tests.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::Result;
use poseaudit::synth::{Motion, Scenario};

/// A short run that can be written to a file.
pub struct ShortRun(pub Scenario);

/// A short run without faults.
pub fn short_run(seed: u64) -> ShortRun {
    let mut run = Scenario::ur5e();
    (run.seed, run.duration_s, run.motion) = (seed + 1, 6.0, Motion::Continuous);
    run.joints.timing.rate_hz = 50.0;
    run.pose.timing.rate_hz = 50.0;
    run.tf.timing.rate_hz = 20.0;
    run.imu.timing.rate_hz = 0.0;
    ShortRun(run)
}

impl ShortRun {
    /// Writes the log, and creates its folders.
    pub fn write(&self, path: &Path) -> Result<()> {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let out = BufWriter::new(File::create(path)?);
        self.0.write_mcap(out, Some(mcap::Compression::Zstd))?;
        Ok(())
    }
}

/// Unpacked size of the chunk of [`write_zip_bomb`], MiB.
pub const BOMB_MIB: usize = 384;

/// Writes an MCAP file of a few kB with one chunk that unpacks to [`BOMB_MIB`].
pub fn write_zip_bomb(path: &Path) -> Result<()> {
    let out = BufWriter::new(File::create(path)?);
    let options = mcap::WriteOptions::new().chunk_size(Some(u64::MAX));
    let mut writer = options.create(out)?;
    let definition = "std_msgs/Header header\nstring[] name\nfloat64[] position";
    let schema =
        writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", definition.as_bytes())?;
    let channel = writer.add_channel(schema, "/joint_states", "cdr", &Default::default())?;
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    writer.write_to_known_channel(&header, &vec![0; BOMB_MIB << 20])?;
    writer.finish()?;
    writer.into_inner().flush()?;
    Ok(())
}
