//! Episodes of a dataset: columns are identified once, and verified in each episode.

use poseaudit::geometry::xyzw_from_rotation;

use super::*;

/// Writes an episode with unnamed columns: joints, then the flange pose; joints last if `has_joints_last`.
fn write_episode(path: &Path, seed: u64, has_joints_last: bool) -> Result<()> {
    let chain = crate::tables::ur5e();
    let mut text = "t,c0,c1,c2,c3,c4,c5,c6,c7,c8,c9,c10,c11,c12\n".to_owned();
    for row in 0..300 {
        let t_s = f64::from(row) / 30.0;
        let center = [0.0, -1.2, 1.4, -1.5, -1.5, 0.0];
        let joint = |(at, center): (usize, f64)| {
            let turn = 0.5 + 0.17 * at as f64 + 0.05 * seed as f64;
            center + 0.5 * (turn * t_s + at as f64).sin() + 0.2 * (2.3 * turn * t_s).cos()
        };
        let q: Vec<f64> = center.into_iter().enumerate().map(joint).collect();
        let pose = chain.forward(&q);
        let xyz: [f64; 3] = pose.translation.vector.into();
        let pose = [xyz.as_slice(), &xyzw_from_rotation(&pose.rotation)].concat();
        let numbers = if has_joints_last { [pose, q].concat() } else { [q, pose].concat() };
        let cells: Vec<String> = numbers.iter().map(|number| format!("{number:.9}")).collect();
        text += &format!("{t_s:.6},{}\n", cells.join(","));
    }
    Ok(fs::write(path, text)?)
}

#[test]
fn columns_are_identified_once_per_dataset_and_contradicting_episodes_are_named() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let logs = folder.path().join("episodes");
    fs::create_dir(&logs)?;
    for seed in 0..7 {
        write_episode(&logs.join(format!("episode_{seed}.csv")), seed, seed == 4)?;
    }
    let out = folder.path().join("out").display().to_string();
    let logs = logs.display().to_string();
    fleet(&[&logs, "--out", &out]).output()?;
    let output = Command::new(env!("CARGO_BIN_EXE_poseaudit"))
        .args(["fleet", "report", &out, "--format", "json"])
        .output()?;
    let report = json(&output)?;
    let columns = &report["datasets"][0]["columns"];
    assert_eq!(columns[0]["columns"], serde_json::json!(["c0", "c1", "c2", "c3", "c4", "c5"]));
    assert_eq!(report["logs"]["statuses"]["audited"], 7, "{report:#}");
    let findings = report["findings"].as_array().context("findings")?;
    let found: Vec<&str> = findings.iter().filter_map(|row| row["code"].as_str()).collect();
    assert_eq!(found, ["META001"], "{report:#}");
    let row = &findings[0];
    assert!(row["path"].as_str().is_some_and(|path| path.ends_with("episode_4.csv")));
    assert!(row["message"].as_str().is_some_and(|what| what.contains("its columns differ from")));
    Ok(())
}
