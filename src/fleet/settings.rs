//! Audit settings with a reproducible hash.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::Options;
use crate::report::Trouble;
use crate::robot::catalogue;

/// Settings of an audit.
#[derive(Clone, Debug, PartialEq)]
pub struct AuditSettings {
    /// 16 digits.
    pub hash: String,
    /// Readable form.
    pub readable: Value,
}

/// 64 bits: there are few settings.
const HASH_DIGITS: usize = 16;

impl AuditSettings {
    /// Files count by their content. The log, the output options and the failing severity are not included.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn from_options(options: &Options) -> Result<Self, Trouble> {
        let Options { read, run, policy, .. } = options;
        let robot = |robot: &crate::run::RobotSource| -> Result<Value, Trouble> {
            let file = Path::new(&robot.model);
            let model = match file.is_file() {
                true => file_hash(file)?,
                false if catalogue::find(&robot.model).is_none() => {
                    return Err(Trouble::call(
                        &robot.model,
                        "neither a file nor an arm of the catalogue",
                        "name a URDF or TOML file, or an arm of `poseaudit robots`",
                    ));
                }
                false => robot.model.clone(),
            };
            Ok(json!({ "prefix": robot.prefix, "model": model }))
        };
        let calibration = |one: &crate::run::CalibrationSource| -> Result<Value, Trouble> {
            Ok(json!({ "prefix": one.prefix, "file": file_hash(&one.file)? }))
        };
        let config = options.config.as_deref();
        // Config entries refer to lines of the config; its path must not affect the hash.
        let place = config.map(|path| path.display().to_string()).filter(|path| !path.is_empty());
        let shown = |text: String| match &place {
            Some(place) => text.replace(place.as_str(), "config"),
            None => text,
        };
        let mut readable = json!({
            "robots": run.robots.iter().map(robot).collect::<Result<Vec<_>, _>>()?,
            "calibrations": run.calibrations.iter().map(calibration).collect::<Result<Vec<_>, _>>()?,
            "joint_map": run.joint_map.iter().map(|of| (&of.logged, &of.modelled)).collect::<Vec<_>>(),
            "base": run.base,
            "tip": run.tip,
            "stamp": format!("{:?}", run.stamp),
            "max_latency_s": run.max_latency_s,
            "verify": read.verify,
            "max_unpacked_gib": read.max_unpacked_gib,
            "declarations": shown(format!("{:?}", run.declared)),
            "topics": shown(format!("{:?}", run.topics)),
            "rules": shown(format!("{:?}", policy.rules)),
            "config": config.map(file_hash).transpose()?,
            "corrections": options.corrections.as_deref().map(file_hash).transpose()?,
        });
        if !read.columns.layouts.is_empty() {
            let layouts = read.columns.layouts.iter();
            readable["columns"] =
                layouts.map(|own| json!([own.file, own.layout.to_string()])).collect();
        }
        let hash = blake3::hash(readable.to_string().as_bytes()).to_hex()[..HASH_DIGITS].to_owned();
        Ok(Self { hash, readable })
    }
}

fn file_hash(path: &Path) -> Result<String, Trouble> {
    let bytes = fs::read(path).map_err(|error| {
        let what = format!("cannot be read: {error}");
        Trouble::call(path.display(), what, "name a readable file")
    })?;
    Ok(format!("blake3:{}", blake3::hash(&bytes).to_hex()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::audit::Policy;
    use crate::config::Config;
    use crate::run::RunOptions;

    #[test]
    fn the_hash_changes_exactly_with_what_changes_an_audit() -> Result<(), Trouble> {
        let plain = AuditSettings::from_options(&Options::default())?;
        let same = Options {
            logs: vec!["a.mcap".into()],
            policy: Policy { fail_on: None, ..Policy::default() },
            ..Options::default()
        };
        assert_eq!(AuditSettings::from_options(&same)?, plain);
        let other = RunOptions { max_latency_s: 4.0, ..RunOptions::default() };
        let other = Options { run: other, ..Options::default() };
        assert_ne!(AuditSettings::from_options(&other)?.hash, plain.hash);
        Ok(())
    }

    #[test]
    fn a_config_counts_by_its_content() -> Result<(), Trouble> {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).expect("a file");
            AuditSettings::from_options(&Config::from_file(&path)?.options())
        };
        let text = "[stream.\"/tcp\"]\nconvention = \"rotvec\"\n";
        assert_eq!(of("a.toml", text)?, of("b.toml", text)?);
        assert_ne!(of("a.toml", text)?, of("a.toml", &text.replace("rotvec", "euler:xyz"))?);
        Ok(())
    }
}
