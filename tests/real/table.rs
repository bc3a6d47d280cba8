//! The table of expected answers on recordings of real arms, and the page generated from it.

use std::fmt::Write as _;

use serde::Deserialize;

const EXPECTED: &str = include_str!("expected.toml");

#[derive(Deserialize)]
pub struct ExpectationTable {
    pub source: Vec<Source>,
}

/// A repository of recordings.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    pub repository: String,
    pub commit: String,
    pub licence: String,
    pub what: String,
    pub truth: String,
    pub audit: Vec<Expectation>,
}

/// An audit of some logs of a source, and the right answer. `tests/real/expected.toml` describes the
/// fields.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expectation {
    pub command: Option<String>,
    pub logs: Vec<String>,
    #[serde(default)]
    pub except: Vec<String>,
    #[serde(default)]
    pub one_run: bool,
    #[serde(default)]
    pub args: Vec<String>,
    pub config: Option<String>,
    pub header: Option<String>,
    #[serde(default)]
    pub arm: Vec<String>,
    pub verdict: Vec<String>,
    #[serde(default)]
    pub must: Vec<String>,
    #[serde(default)]
    pub may: Vec<String>,
    #[serde(default)]
    pub says: Vec<String>,
    pub max_held_out_mm: Option<f64>,
    pub open: Option<String>,
}

/// Reads the table.
pub fn sources() -> Result<Vec<Source>, toml::de::Error> {
    toml::from_str(EXPECTED).map(|ExpectationTable { source }| source)
}

/// Arguments of an expectation, shortened for the summary.
pub fn arguments_of(expectation: &Expectation) -> String {
    let mut call = match &expectation.command {
        Some(command) => format!("`{command}` "),
        None => String::new(),
    };
    for arg in &expectation.args {
        call += &format!("{arg} ");
    }
    if expectation.config.is_some() {
        call += "--config … ";
    }
    if expectation.header.is_some() {
        call += "with a header";
    }
    let call = call.trim();
    if call.is_empty() { "as recorded".to_owned() } else { call.to_owned() }
}

/// As code, because `_` and `*` are marks of Markdown.
fn quoted_arguments(expectation: &Expectation) -> String {
    let call = arguments_of(expectation);
    if expectation.args.is_empty() { call } else { format!("`{call}`") }
}

/// Generates `docs/real-logs.md`.
pub fn markdown(sources: &[Source]) -> String {
    let mut page = "# Real logs\n\n\
        For those who want to know how far the answers can be trusted on recordings that nobody simulated. \
        These are public recordings of real arms; most state no licence, so they are not part of this project. \
        `cargo run --release --example real_logs -- FOLDER` audits those that are below FOLDER as `OWNER/NAME` and compares \
        the answers with [expected.toml](../tests/real/expected.toml), from which this page is made \
        (`cargo run --example real_logs -- --markdown`). The truth was determined with an independent forward kinematics. \
        *Answer* is what is right; *wrong today* is what the program still gets wrong.\n"
        .to_owned();
    for source in sources {
        let Source { repository, commit, licence, what, truth, audit } = source;
        let _infallible = write!(
            page,
            "\n## {repository}\n\n{what}. Commit `{commit}`, licence: {licence}.\n\nTruth: {truth}\n\n\
             | logs | arguments | arm | answer | wrong today |\n|---|---|---|---|---|\n"
        );
        for line in audit {
            let mut answer = line.verdict.join(" or ");
            for (what, codes) in [(" with ", &line.must), ("; may name ", &line.may)] {
                if !codes.is_empty() {
                    answer += what;
                    answer += &codes.join(", ");
                }
            }
            if let Some(most) = line.max_held_out_mm {
                answer += &format!("; held-out residual at most {most} mm rms");
            }
            let _infallible = writeln!(
                page,
                "| {} | {} | {} | {answer} | {} |",
                line.logs.iter().map(|logs| format!("`{logs}`")).collect::<Vec<_>>().join(", "),
                quoted_arguments(line),
                line.arm.join(", "),
                line.open.as_deref().unwrap_or_default(),
            );
        }
    }
    page
}
