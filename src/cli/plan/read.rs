//! Reads motions from files.

use std::path::Path;

use poseaudit::report::Trouble;
use poseaudit::robot::Chain;
use poseaudit::stream::JointTrack;
use serde::Deserialize;

use super::super::{misuse, output};

/// Columns in file order.
struct MotionTable {
    names: Vec<String>,
    t_s: Vec<f64>,
    q: Vec<Vec<f64>>,
    qd: Vec<Vec<f64>>,
}

/// Reads a motion: CSV with time and joint columns, JSON of `plan`, or a JointTrajectory in YAML, detected
/// from the content. Fails if it is none of these or lacks a joint.
pub fn read_motion(path: &Path, chain: &Chain) -> Result<JointTrack, Trouble> {
    const MAX_BYTES: u64 = 256 << 20;
    let place = path.display();
    let bytes = std::fs::metadata(path).map(|it| it.len()).unwrap_or(0);
    if bytes > MAX_BYTES {
        return Err(misuse(&place, "too large for a motion", "use a shorter one"));
    }
    let text = std::fs::read_to_string(path)
        .map_err(|error| misuse(&place, error, "name a file with a motion"))?;
    let misread = |what: String| {
        misuse(
            &place,
            what,
            "write it as CSV (t_s and a column for each joint), as JSON of `poseaudit plan`, or as a \
             JointTrajectory in YAML",
        )
    };
    let text = text.trim_start_matches('\u{feff}');
    let first = text.trim_start().chars().next();
    let has_points = text.lines().any(|line| line.trim_start().starts_with("points:"));
    let listed = match first {
        Some('{') if text.contains("\"trajectory\"") => parse_json(text),
        _ if has_points || first == Some('{') => parse_yaml(text),
        Some(_) => parse_csv(text, chain),
        None => Err("it is empty".to_owned()),
    };
    listed.and_then(|listed| listed.into_track(chain)).map_err(misread)
}

impl MotionTable {
    /// Orders columns by the chain; derives missing speeds from positions.
    fn into_track(self, chain: &Chain) -> Result<JointTrack, String> {
        let places = chain.joint_names().iter().map(|name| {
            let at = self.names.iter().position(|name_in_file| name_in_file == name);
            at.ok_or_else(|| format!("no joint {name}; it has {}", self.names.join(", ")))
        });
        let places = places.collect::<Result<Vec<usize>, String>>()?;
        let dof = places.len();
        if self.t_s.len() < 3 {
            return Err(format!("it has {} points; 3 are needed", self.t_s.len()));
        }
        if let Some(at) = self.t_s.windows(2).position(|pair| pair[1] <= pair[0]) {
            return Err(format!("times do not increase after {} s", self.t_s[at]));
        }
        let mut track = JointTrack { dof, t_s: self.t_s, ..JointTrack::default() };
        let has_speeds = self.qd.iter().all(|row| row.len() == self.names.len());
        for (row, q) in self.q.iter().enumerate() {
            if q.len() != self.names.len() {
                return Err(format!("point {} has {} positions", row + 1, q.len()));
            }
            track.q.extend(places.iter().map(|&place| q[place]));
            if has_speeds {
                track.qd.extend(places.iter().map(|&place| self.qd[row][place]));
            }
        }
        if !track.t_s.iter().chain(&track.q).chain(&track.qd).all(|number| number.abs() < 1e9) {
            return Err("it has a value that is not finite, or beyond any arm's range".to_owned());
        }
        let by_positions = speeds_from_positions(&track);
        if has_speeds && !are_speeds_consistent(&track.qd, &by_positions) {
            output::warning(
                "speeds in the file contradict the positions; using the derivative of the positions",
            );
            track.qd = by_positions;
        } else if !has_speeds {
            track.qd = by_positions;
        }
        Ok(track)
    }
}

/// Whether speeds match finite differences, within discretisation error.
fn are_speeds_consistent(given: &[f64], by_positions: &[f64]) -> bool {
    /// Tolerance as a share of the highest speed.
    const MAX_SPEED_DEVIATION_RATIO: f64 = 0.1;
    let highest = by_positions.iter().fold(1e-3_f64, |highest, speed| highest.max(speed.abs()));
    let off = given.iter().zip(by_positions).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    (off / given.len().max(1) as f64).sqrt() < MAX_SPEED_DEVIATION_RATIO * highest
}

fn speeds_from_positions(track: &JointTrack) -> Vec<f64> {
    let last = track.len() - 1;
    let at = |row: usize, joint: usize| {
        let (from, to) = (row.saturating_sub(1), (row + 1).min(last));
        let step_s = track.t_s[to] - track.t_s[from];
        (track.row(to)[joint] - track.row(from)[joint]) / step_s
    };
    (0..=last)
        .flat_map(|row| (0..track.dof).map(move |joint| (row, joint)))
        .map(|(row, joint)| at(row, joint))
        .collect()
}

fn parse_csv(text: &str, chain: &Chain) -> Result<MotionTable, String> {
    const TIME_COLUMNS: [&str; 6] = ["t_s", "t", "time", "time_s", "timestamp", "stamp"];
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| error.to_string())?.clone();
    let place =
        |name: &str| header.iter().position(|name_in_file| name_in_file.eq_ignore_ascii_case(name));
    let time = TIME_COLUMNS.iter().find_map(|name| place(name));
    let time = time.ok_or_else(|| format!("no column {}", TIME_COLUMNS.join(", ")))?;
    let names = chain.joint_names();
    let columns = names.iter().map(|name| {
        let named = header.iter().position(|name_in_file| name_in_file == name);
        let columns = header.iter().collect::<Vec<_>>().join(", ");
        named.ok_or_else(|| format!("no column {name}; it has {columns}"))
    });
    let columns = columns.collect::<Result<Vec<usize>, String>>()?;
    let speeds: Option<Vec<usize>> =
        names.iter().map(|name| place(&format!("{name}.velocity"))).collect();
    let (mut t_s, mut q, mut qd) = (Vec::new(), Vec::new(), Vec::new());
    for record in reader.records() {
        let record = record.map_err(|error| error.to_string())?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize| {
            let text = record.get(column).unwrap_or_default();
            text.parse::<f64>().map_err(|_| format!("line {line} has `{text}` instead of a number"))
        };
        t_s.push(number(time)?);
        q.push(columns.iter().map(|&column| number(column)).collect::<Result<_, _>>()?);
        let speeds = speeds.iter().flatten().map(|&column| number(column));
        qd.push(speeds.collect::<Result<Vec<f64>, String>>()?);
    }
    Ok(MotionTable { names: names.to_vec(), t_s, q, qd })
}

fn parse_json(text: &str) -> Result<MotionTable, String> {
    #[derive(Deserialize)]
    struct Plan {
        joints: Vec<Joint>,
        trajectory: Trajectory,
    }
    #[derive(Deserialize)]
    struct Joint {
        name: String,
    }
    #[derive(Deserialize)]
    struct Trajectory {
        t_s: Vec<f64>,
        q: Vec<Vec<f64>>,
        #[serde(default)]
        qd: Vec<Vec<f64>>,
    }
    let Plan { joints, trajectory: Trajectory { t_s, q, mut qd } } =
        serde_json::from_str(text).map_err(|error| error.to_string())?;
    if q.len() != t_s.len() || !(qd.is_empty() || qd.len() == q.len()) {
        return Err("q and t_s of its trajectory differ in length".to_owned());
    }
    qd.resize(q.len(), Vec::new());
    Ok(MotionTable { names: joints.into_iter().map(|joint| joint.name).collect(), t_s, q, qd })
}

fn parse_yaml(text: &str) -> Result<MotionTable, String> {
    #[derive(Deserialize)]
    struct Trajectory {
        joint_names: Vec<String>,
        points: Vec<Point>,
    }
    #[derive(Deserialize)]
    struct Point {
        positions: Vec<f64>,
        #[serde(default)]
        velocities: Vec<f64>,
        time_from_start: Duration,
    }
    #[derive(Deserialize)]
    struct Duration {
        #[serde(alias = "secs")]
        sec: i64,
        #[serde(default, alias = "nsecs")]
        nanosec: i64,
    }
    // `ros2 topic echo` ends with a separator line.
    let document = text.trim_end().trim_end_matches("---").trim_end_matches("...");
    let Trajectory { joint_names, points } =
        serde_saphyr::from_str(document).map_err(|error| error.to_string())?;
    let seconds = |it: &Duration| it.sec as f64 + it.nanosec as f64 * 1e-9;
    let t_s = points.iter().map(|point| seconds(&point.time_from_start)).collect();
    let (q, qd) = points.into_iter().map(|point| (point.positions, point.velocities)).unzip();
    Ok(MotionTable { names: joint_names, t_s, q, qd })
}
