//! Questions, the rules that answer them, and the streams needed.

use poseaudit::report::{Report, StreamRow};

/// Stream or model needed to answer a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    Joints,
    Model,
    Pose,
    Tracker,
    Tf,
    Imu,
    Mount,
    Target,
    Reference,
}

impl Need {
    pub fn description(self) -> &'static str {
        match self {
            Need::Joints => "joint states of the arm",
            Need::Model => "the robot's description, or --robot",
            Need::Pose => "poses of the tool",
            Need::Tracker => "poses of the tool by a tracker or a camera",
            Need::Tf => "/tf",
            Need::Imu => "an IMU on the arm, with its orientation",
            Need::Mount => "/tf_static, with the frame of the IMU",
            Need::Target => "poses of a target seen by a camera",
            Need::Reference => "commanded or desired poses, or joints",
        }
    }

    pub fn roles(self) -> &'static [&'static str] {
        match self {
            Need::Joints => &["joints"],
            Need::Model => &["description"],
            Need::Pose | Need::Tracker => &["pose"],
            Need::Tf => &["tf"],
            Need::Imu => &["imu"],
            Need::Mount => &["tf_static"],
            Need::Target => &["target"],
            Need::Reference => &["reference"],
        }
    }

    pub fn streams(self, report: &Report) -> Vec<&StreamRow> {
        let is_it = |stream: &&StreamRow| {
            let is_outside = matches!(stream.source_kind, Some("external"));
            self.roles().contains(&stream.role)
                && (stream.count > 0)
                && (self != Need::Tracker || is_outside)
        };
        report.streams.iter().filter(is_it).collect()
    }

    /// A model may come from the catalogue.
    pub fn is_met(self, report: &Report) -> bool {
        (self == Need::Model && !report.robots.is_empty()) || !self.streams(report).is_empty()
    }
}

#[derive(Debug)]
pub struct Question {
    pub text: &'static str,
    pub rules: &'static [&'static str],
    pub needs: &'static [Need],
}

/// Each rule belongs to exactly one.
pub const QUESTIONS: &[Question] = &[
    Question {
        text: "Is the log complete, and are its stamps valid?",
        rules: &[
            "ING001", "ING002", "ING003", "TIM001", "TIM002", "TIM003", "TIM004", "TIM005",
            "TIM006", "TIM007", "TIM008", "META001", "META002", "FRM004", "FRM005", "FRM007",
        ],
        needs: &[],
    },
    Question {
        text: "How does the arm move?",
        rules: &["MOT001", "MOT002", "MOT003", "MOT005", "VEL001"],
        needs: &[Need::Joints, Need::Model],
    },
    Question {
        text: "Do encoding, frames and timing of the poses match their metadata and the joints?",
        rules: &[
            "ORD001", "ORD002", "ORD003", "ORD004", "ORD005", "ORD006", "ORD007", "ORD008",
            "ORD009", "ORD010", "ORD011", "FRM002", "FRM003", "LAT001", "LAT002", "LAT003",
            "MDL001", "ZER001",
        ],
        needs: &[Need::Joints, Need::Model, Need::Pose],
    },
    Question {
        text: "Does the arm deviate beyond what its own encoders see: link lengths, sag, backlash?",
        rules: &["ZER002", "ZER003", "MOT006"],
        needs: &[Need::Joints, Need::Model, Need::Tracker],
    },
    Question {
        text: "Does /tf agree with the joints?",
        rules: &["FRM001"],
        needs: &[Need::Joints, Need::Model, Need::Tf],
    },
    Question {
        text: "Does an IMU drift, tilt or have a wrong mount?",
        rules: &["YAW001", "YAW002", "YAW003", "YAW004"],
        needs: &[Need::Joints, Need::Model, Need::Imu, Need::Mount],
    },
    Question {
        text: "Does the hand-eye chain close?",
        rules: &["HEC001", "HEC002", "HEC003"],
        needs: &[Need::Joints, Need::Model, Need::Target],
    },
    Question {
        text: "Does the arm follow its commands?",
        rules: &["FRM006", "LAT004", "MOT004"],
        needs: &[Need::Joints, Need::Model, Need::Reference],
    },
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use poseaudit::checks::registry;
    use poseaudit::finding::Status;
    use poseaudit::{Options, audit};

    use super::*;

    #[test]
    fn every_rule_answers_one_question() {
        let listed: Vec<&str> =
            QUESTIONS.iter().flat_map(|question| question.rules).copied().collect();
        let known: BTreeSet<&str> = registry().iter().map(|rule| rule.code).collect();
        assert_eq!(listed.len(), known.len(), "each rule must be in one question");
        assert_eq!(listed.into_iter().collect::<BTreeSet<_>>(), known);
    }

    #[test]
    fn a_question_whose_needs_are_met_is_asked_and_one_whose_stream_is_missing_is_skipped() {
        let fixtures = ["faulty", "slipped_target", "goal", "imu"];
        let mut held = BTreeSet::new();
        for name in fixtures {
            let path = format!("{}/fixtures/{name}.mcap", env!("CARGO_MANIFEST_DIR"));
            let options = Options { logs: vec![path.into()], ..Options::default() };
            let report = audit(&options).expect("a report").report;
            for (index, question) in
                QUESTIONS.iter().enumerate().filter(|(_, it)| !it.needs.is_empty())
            {
                let Some(last) = question.needs.last() else { continue };
                let rows = report.checks.iter().filter(|row| question.rules.contains(&row.code));
                let is_asked = |row: &&poseaudit::finding::CheckRow| row.status != Status::Skipped;
                let asked = rows.filter(is_asked).count();
                if question.needs.iter().all(|need| need.is_met(&report)) {
                    assert!(asked > 0, "{name}: {}", question.text);
                    held.insert((index, true));
                } else if !matches!(last, Need::Tracker | Need::Mount | Need::Pose) {
                    assert_eq!(asked, 0, "{name}: {}", question.text);
                    held.insert((index, false));
                }
            }
        }
        assert!(held.len() >= 9, "too few needs were tested: {held:?}");
    }
}
