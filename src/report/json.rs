//! Report as one JSON object in SI units.

use std::io::{self, Write};

use schemars::generate::SchemaSettings;

use super::Report;

/// Numbers that are not finite become `null`.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, report)?;
    writeln!(out)
}

/// `docs/poseaudit.report.schema.json`, ending with a newline.
pub fn schema() -> String {
    let settings = SchemaSettings::draft07().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<Report>();
    let mut text = serde_json::to_string_pretty(&schema).expect("a schema is JSON");
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::finding::{Angle, Change, Estimate, Interpretation, JointRelation, RunnerUp};
    use crate::time::Stamp;

    fn any_estimate() -> impl Strategy<Value = Estimate> {
        let number = any::<f64>().prop_filter("finite", |number| number.is_finite());
        let interval = || prop::option::of([number.clone(), number.clone()]);
        let (text, names) = (|| ".{0,9}", || prop::collection::vec(".{0,9}", 0..4));
        let word = || prop::sample::select(vec!["latency", "rad/s", "", "°"]);
        let stamp = || any::<i64>().prop_map(Stamp::from_nanos);
        let change =
            (number.clone(), number.clone(), stamp(), prop::option::of([stamp(), stamp()]))
                .prop_map(|(from, to, change_ns, change_ci95_ns)| Change {
                    from,
                    to,
                    change_ns,
                    change_ci95_ns,
                });
        let change = prop::option::of(change).boxed();
        let some = || prop::option::of(number.clone());
        let relation = (prop::option::of(text()), some(), some())
            .prop_map(|(with, factor, turns)| JointRelation { with, factor, turns });
        let amount = (word(), number.clone(), word(), interval(), change.clone(), relation)
            .prop_map(|(name, value, unit, ci95, change, joint)| Estimate::Scalar {
                name,
                value,
                unit,
                ci95,
                change,
                joint,
            });
        let angle = (number.clone(), interval()).prop_map(|(value, ci95)| Angle { value, ci95 });
        let frame = (word(), number.clone(), interval(), angle, change).prop_map(
            |(name, value, ci95, rotation, change)| Estimate::Frame {
                name,
                value,
                unit: "m",
                ci95,
                rotation,
                change,
            },
        );
        let runner_up = prop::option::of((text(), text(), number.clone()));
        let convention =
            (text(), text(), names(), runner_up).prop_map(|(is, read_as, others, runner_up)| {
                Estimate::Convention {
                    name: "convention",
                    is,
                    equivalent: others
                        .into_iter()
                        .map(|is| Interpretation { is, read_as: read_as.clone() })
                        .collect(),
                    read_as,
                    runner_up: runner_up.map(|(is, read_as, ratio)| RunnerUp {
                        is,
                        read_as,
                        ratio,
                    }),
                }
            });
        let slip = (text(), text())
            .prop_map(|(is, read_as)| Estimate::misinterpretation("unit", is, read_as));
        let order = (names(), names()).prop_map(|(is, read_as)| Estimate::Order {
            name: "order",
            permutation: is.clone(),
            is,
            read_as,
        });
        prop_oneof![amount, frame, convention, slip, order]
    }

    proptest! {
        #[test]
        fn every_estimate_round_trips(estimate in any_estimate()) {
            let text = serde_json::to_string(&estimate).expect("JSON");
            prop_assert_eq!(serde_json::from_str::<Estimate>(&text).expect("an estimate"), estimate);
        }
    }

    #[test]
    fn non_finite_numbers_are_read_back_as_nan() {
        let text = r#"{"name":"latency","value":null,"unit":"s","ci95":null}"#;
        let read: Estimate = serde_json::from_str(text).expect("an estimate");
        assert!(read.value().expect("a number").is_nan());
        assert_eq!(serde_json::to_string(&read).expect("JSON"), text);
    }
}
