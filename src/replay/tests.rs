use super::*;
use crate::diagnosis::Aligned;
use crate::finding::{Evidence, Severity, Subject};
use crate::robot::catalogue;
use crate::tables::{AFTER_M, aligned_frame};

type Outcome = Result<(), Box<dyn std::error::Error>>;

const ORIGIN: Stamp = Stamp::from_nanos(1_780_000_000_000_000_000);

fn chain() -> Chain {
    let robot = catalogue::find("ur5e").unwrap();
    robot.chain(robot.link("base").unwrap(), robot.link("tool0").unwrap()).unwrap()
}

/// Half a second of the shoulder turning, and poses that agree with it.
fn motion(chain: &Chain) -> (JointTrack, Aligned) {
    let mut joints = JointTrack { dof: chain.dof(), ..JointTrack::default() };
    let mut aligned = Aligned::default();
    for row in 0..50 {
        let t_s = f64::from(row) * 0.01;
        let mut q = vec![0.5; chain.dof()];
        q[0] = t_s;
        aligned.t_s.push(t_s);
        let base_from_tip = chain.forward(&q);
        for poses in
            [&mut aligned.logged, &mut aligned.fk, &mut aligned.corrected, &mut aligned.fk_at_truth]
        {
            poses.push(base_from_tip);
        }
        joints.t_s.push(t_s);
        joints.q.extend(&q);
        joints.qd.extend([0.0; 6]);
    }
    (joints, aligned)
}

fn finding() -> Finding {
    Finding {
        code: "LAT001",
        severity: Severity::Error,
        title: "late",
        message: "22 ms late".to_owned(),
        subject: Subject { topic: Some("/tcp/pose".to_owned()), ..Subject::default() },
        estimate: None,
        evidence: Evidence { effect: Some("26 mm".to_owned()), ..Evidence::default() },
        fix: "stamp it when it is sampled".to_owned(),
        start_ns: Some(ORIGIN),
        end_ns: None,
    }
}

fn stream(aligned: &Aligned, kind: StreamKind) -> Result<ReplayStream<'static>, PolarsError> {
    Ok(ReplayStream {
        topic: if kind == StreamKind::Tf { "/tf" } else { "/tcp/pose" },
        kind,
        frame: aligned_frame(aligned, ORIGIN)?,
        base_from_reference: Pose::identity(),
        reference_known: true,
        latency_s: 0.022,
    })
}

#[test]
fn a_recording_is_written_with_its_folder() -> Outcome {
    let (chain, findings) = (chain(), [finding()]);
    let (recorded, aligned) = motion(&chain);
    let mut corrected = recorded.clone();
    corrected.q.iter_mut().for_each(|position| *position += 0.01);
    let arm = ReplayArm {
        name: "ur5e",
        chain: &chain,
        columns: &[0, 1, 2, 3, 4, 5],
        recorded: &recorded,
        corrected,
        streams: vec![stream(&aligned, StreamKind::Pose)?, stream(&aligned, StreamKind::Tf)?],
        imus: vec![ReplayImu { topic: "/imu/data", yaw_error: &[(0.0, 0.1), (0.1, 0.2)] }],
    };
    let (verdict, arms) = (Verdict::Fail, vec![arm]);
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("made/run.rrd");
    write(
        &Recording::from(path.clone()),
        &Replay { origin: ORIGIN, arms, verdict, findings: &findings },
    )?;
    let bytes = std::fs::read(&path)?;
    assert!(bytes.starts_with(b"RRF2") && bytes.len() > 10_000);
    Ok(())
}

#[test]
fn a_run_without_an_arm_still_has_its_page() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("run.rrd");
    let verdict = Verdict::Inconclusive;
    write(
        &Recording::from(path.clone()),
        &Replay { origin: ORIGIN, arms: Vec::new(), verdict, findings: &[] },
    )?;
    assert!(std::fs::read(&path)?.starts_with(b"RRF2"));
    Ok(())
}

#[test]
fn an_error_names_the_file() -> Outcome {
    let folder = tempfile::tempdir()?;
    let replay = Replay { origin: ORIGIN, arms: Vec::new(), verdict: Verdict::Pass, findings: &[] };
    let error = write(&Recording::from(folder.path().to_owned()), &replay).unwrap_err();
    assert!(error.to_string().starts_with(&folder.path().display().to_string()), "{error}");
    assert!(matches!(error.cause, ReplayCause::Recording(_)));
    Ok(())
}

#[test]
fn a_frame_without_its_columns_is_an_error() -> Outcome {
    let chain = chain();
    let (recorded, aligned) = motion(&chain);
    let mut broken = stream(&aligned, StreamKind::Pose)?;
    broken.frame = broken.frame.drop(AFTER_M)?;
    let arm = ReplayArm {
        name: "ur5e",
        chain: &chain,
        columns: &[0, 1, 2, 3, 4, 5],
        recorded: &recorded,
        corrected: recorded.clone(),
        streams: vec![broken],
        imus: Vec::new(),
    };
    let folder = tempfile::tempdir()?;
    let replay = Replay { origin: ORIGIN, arms: vec![arm], verdict: Verdict::Pass, findings: &[] };
    let error = write(&Recording::from(folder.path().join("run.rrd")), &replay).unwrap_err();
    assert!(matches!(error.cause, ReplayCause::Frame(_)), "{error}");
    Ok(())
}

#[test]
fn the_topic_is_named_only_where_the_state_alone_does_not_tell() -> Outcome {
    let chain = chain();
    let (recorded, aligned) = motion(&chain);
    let mut arm = ReplayArm {
        name: "ur5e",
        chain: &chain,
        columns: &[0, 1, 2, 3, 4, 5],
        recorded: &recorded,
        corrected: recorded.clone(),
        streams: vec![stream(&aligned, StreamKind::Pose)?, stream(&aligned, StreamKind::Tf)?],
        imus: Vec::new(),
    };
    let of = |arm: &ReplayArm<'_>, row: usize| arm.label(&arm.streams[row], State::Logged);
    assert_eq!((of(&arm, 0), of(&arm, 1)), ("as logged".to_owned(), "/tf".to_owned()));
    arm.streams.push(stream(&aligned, StreamKind::Pose)?);
    assert_eq!(of(&arm, 0), "/tcp/pose as logged");
    Ok(())
}
