//! Calibration report for people.

use std::fmt::Write as _;
use std::io;

use crate::audit::{CalibrationResult, Measurement};
use crate::diagnosis::{CalibrationResidual, StreamCalibration};
use crate::finding::Unit;
use crate::report::sanitize_display;
use crate::run::PoseSourceKind;

/// Unobservable directions listed.
const MAX_LISTED_DIRECTIONS: usize = 6;
/// Directions with less effect on the tip over the workspace are irrelevant, m.
const MIN_EFFECT_M: f64 = 1e-6;

impl CalibrationResult {
    /// Writes the results and the names of the `files`.
    pub fn write_text(&self, files: &[String], out: &mut dyn io::Write) -> io::Result<()> {
        out.write_all(self.text(files).as_bytes())
    }

    /// Depends on the source of the poses.
    pub(super) fn subject(&self) -> &'static str {
        if self.streams.iter().all(|stream| stream.measurement == Measurement::FixedPoint) {
            return "the arm itself, by a point of the tool that stays at one place";
        }
        match self.source_kind() {
            PoseSourceKind::Controller => {
                "the controller's own kinematics: its poses are computed from the same encoders and do not \
                 show where the arm really is"
            }
            PoseSourceKind::External => "the arm itself, measured by an independent reference",
            PoseSourceKind::Unknown => {
                "undetermined: the arm itself if the poses are an independent measurement, the controller's \
                 own kinematics if they come from the controller"
            }
        }
    }

    fn text(&self, files: &[String]) -> String {
        let found = &self.calibration;
        let mut text = String::new();
        let name = sanitize_display(&self.nominal.name);
        let _ = match &self.rejection {
            None if self.equals_nominal => writeln!(
                text,
                "UNCHANGED   {name}: the arm equals its model within the uncertainty of the calibration, \
                 {:.4} mm rms over the workspace",
                1e3 * found.calibrated_uncertainty.m
            ),
            None => writeln!(text, "CALIBRATED  {name}: {}", sanitize_display(self.subject())),
            Some(why) => writeln!(text, "REFUSED     {name}: {}", sanitize_display(why)),
        };
        let streams = || self.streams.iter().zip(&found.streams);
        self.write_fixed_points(&mut text);
        for (taken, stream) in streams().filter(|one| one.0.measurement != Measurement::FixedPoint)
        {
            let reading =
                taken.encoding.as_ref().map_or_else(String::new, |it| format!(", read as {it}"));
            let (log, topic, tip) = (
                sanitize_display(taken.log.display()),
                sanitize_display(&taken.topic),
                sanitize_display(&taken.tip),
            );
            let _ = writeln!(
                text,
                "\n{log} {topic} ({}): {} poses of {tip} in {}{reading}",
                taken.source_kind.name(),
                stream.samples,
                if stream.reference.is_some() {
                    "an unknown frame".to_owned()
                } else {
                    sanitize_display(&taken.base)
                },
            );
            let line = |of: &CalibrationResidual| match taken.is_rotation_excluded() {
                true => format!("{:.4} mm", 1e3 * of.m),
                false => format!("{:.4} mm, {:.5}°", 1e3 * of.m, of.rad.to_degrees()),
            };
            let _ = writeln!(text, "  residual, nominal        {} rms", line(&stream.before));
            let _ = writeln!(text, "  residual, calibrated     {} rms", line(&stream.after));
            let _ = writeln!(
                text,
                "  cross-validated residual: {} nominal, {} calibrated",
                line(&stream.held_out_before),
                line(&stream.held_out_after)
            );
            if stream.before.m <= 1.05 * stream.after.m {
                text += "  no significant deviation: calibrated links fit this log no better than nominal ones\n";
            }
            if let Some(latency) = stream.latency_s {
                let _ = writeln!(text, "  latency {}", format_measured(Unit::Second, latency));
            }
        }
        for why in &self.left_out {
            let _ = writeln!(text, "\nleft out: {}", sanitize_display(why));
        }
        if let Some(moved) = found.remaining_step {
            let _ = writeln!(
                text,
                "\nnot converged: the last iteration still changed the parameters by {moved:.3} standard \
                 deviations rms; check the logs with `poseaudit audit`"
            );
        }
        let _ = writeln!(
            text,
            "\nlinks deviate from the nominal model by {:.3} mm and {:.4}° per axis (standard deviation, at most \
             {:.3} mm)",
            1e3 * found.link_m,
            (0.1 / 1e-3) * found.link_m,
            1e3 * found.max_link_m
        );
        let _ = writeln!(
            text,
            "uncertainty of FK over the whole workspace: {:.4} mm and {:.5}° rms; error of the nominal \
             model: {:.3} mm and {:.4}°",
            1e3 * found.calibrated_uncertainty.m,
            found.calibrated_uncertainty.rad.to_degrees(),
            1e3 * found.nominal_uncertainty.m,
            found.nominal_uncertainty.rad.to_degrees()
        );
        let largest = self.largest_deviations();
        if !largest.is_empty() {
            text += "\nlargest deviations\n";
        }
        for (name, at) in largest {
            let value = found.value(at);
            let turns = found.parameters.get(at).is_none_or(|one| one.is_rotation);
            let shown = format_measured(if turns { Unit::Radian } else { Unit::Metre }, value);
            let _ = writeln!(text, "  {name:<34} {shown}");
        }
        self.write_undetermined(&mut text);
        if files.iter().any(|file| file.ends_with("calibration.yaml")) {
            let last = found.links.len() - 1;
            let beyond = found.deviations[last].iter().zip(found.std_errors(last));
            if beyond.clone().any(|(value, error)| value.abs() > 3.0 * error && error > 0.0) {
                let [x, y, z, ..] = found.deviations[last];
                let _ = writeln!(
                    text,
                    "\ncalibration.yaml ends at {}: the remaining offset ({:.3} mm) is only in robot.urdf",
                    found.links[last],
                    1e3 * (x * x + y * y + z * z).sqrt()
                );
            }
        }
        match files {
            [] if self.rejection.is_none() => {
                text += "\nnothing was written, because the model needs no correction; --force writes it\n";
            }
            [] => text += "\nnothing was written\n",
            files => {
                let _ = writeln!(text, "\nwritten: {}", sanitize_display(files.join(", ")));
            }
        }
        text
    }

    /// One line per file.
    fn write_fixed_points(&self, text: &mut String) {
        let found = &self.calibration;
        let streams = || {
            let all = self.streams.iter().zip(&found.streams);
            all.filter(|one| one.0.measurement == Measurement::FixedPoint)
        };
        if streams().next().is_none() {
            return;
        }
        let mm = |m: f64| format!("{:.3}", 1e3 * m);
        let _ = writeln!(
            text,
            "\ndistance of the rows from their fixed point, mm rms: all files fitted, and each held-out position \
             predicted from the others\n{:>5}  {:^21}  {:^21}",
            "rows", "fitted", "held out"
        );
        for (taken, stream) in streams() {
            let change = |before: &CalibrationResidual, after: &CalibrationResidual| {
                format!("{:>9} → {:<9}", mm(before.m), mm(after.m))
            };
            let _ = writeln!(
                text,
                "{:>5}  {}  {}  {}",
                stream.samples,
                change(&stream.before, &stream.after),
                change(&stream.held_out_before, &stream.held_out_after),
                sanitize_display(taken.log.display())
            );
        }
        let all = |of: fn(&StreamCalibration) -> f64| {
            let squares: f64 = streams().map(|(_, one)| one.samples as f64 * of(one).powi(2)).sum();
            mm((squares / streams().map(|(_, one)| one.samples as f64).sum::<f64>()).sqrt())
        };
        let _ = writeln!(
            text,
            "{:>5}  {:>9} → {:<9}  {:>9} → {:<9}  all",
            streams().map(|(_, one)| one.samples).sum::<usize>(),
            all(|one| one.before.m),
            all(|one| one.after.m),
            all(|one| one.held_out_before.m),
            all(|one| one.held_out_after.m)
        );
        for (distance, [before, after]) in self.distances.iter().zip(&found.distances_m) {
            let folder = self.streams[distance.streams[0]].log.parent();
            let _ = writeln!(
                text,
                "distance of the two points in {}: {} → {} mm, given {} mm",
                sanitize_display(folder.unwrap_or(std::path::Path::new(".")).display()),
                mm(*before),
                mm(*after),
                mm(distance.distance_m)
            );
        }
    }

    fn largest_deviations(&self) -> Vec<(String, usize)> {
        const MAX_PARAMETERS: usize = 8;
        let found = &self.calibration;
        let size = |at: usize| {
            let scale = if found.parameters.get(at).is_none_or(|one| one.is_rotation) {
                1.745
            } else {
                1.0
            };
            (found.values[at] / scale).abs()
        };
        let mut all: Vec<(String, usize)> = self.parameter_names().into_iter().zip(0..).collect();
        all.retain(|(_, at)| {
            found.value(*at).interval(0.95).iter().all(|end| *end > 0.0)
                || found.value(*at).interval(0.95).iter().all(|end| *end < 0.0)
        });
        all.sort_by(|a, b| size(b.1).total_cmp(&size(a.1)));
        all.truncate(MAX_PARAMETERS);
        all
    }

    fn write_undetermined(&self, text: &mut String) {
        let found = &self.calibration;
        let names = self.parameter_names();
        text.push_str("\nfixed by convention, because poses do not determine it\n");
        for said in self.conventions() {
            let _ = writeln!(text, "  {said}");
        }
        let (harmless, missing): (Vec<_>, Vec<_>) =
            found.undetermined.iter().partition(|one| one.effect_m < MIN_EFFECT_M);
        let list = |text: &mut String, of: &[&crate::diagnosis::UndeterminedDirection]| {
            for one in of.iter().take(MAX_LISTED_DIRECTIONS) {
                let parts: Vec<&str> =
                    one.parts.iter().take(4).map(|(at, _)| names[*at].as_str()).collect();
                let _ = writeln!(
                    text,
                    "  {} together: {:.4} mm at the tip",
                    parts.join(", "),
                    1e3 * one.effect_m
                );
            }
            if of.len() > MAX_LISTED_DIRECTIONS {
                let _ = writeln!(text, "  and {} more", of.len() - MAX_LISTED_DIRECTIONS);
            }
        };
        if !harmless.is_empty() {
            text.push_str(
                "\nkept nominal, without effect on any pose (part of a free frame, or along \
                parallel axes)\n",
            );
            list(text, &harmless);
        }
        if !missing.is_empty() {
            text.push_str("\nkept nominal, not observable in this motion\n");
            list(text, &missing);
        }
        if !self.unmoved.is_empty() {
            text.push_str("\nmotion that would make more observable\n");
            for one in &self.unmoved {
                let _ = match one.slides {
                    true => writeln!(
                        text,
                        "  move {} through 0.2 m or more; it moved {:.3} m",
                        one.joint, one.moved
                    ),
                    false => writeln!(
                        text,
                        "  turn {} through 90° or more in several configurations of the other joints; it \
                         moved {:.1}°",
                        one.joint,
                        one.moved.to_degrees()
                    ),
                };
            }
            if let Some(plan) = &self.plan {
                let _ = writeln!(text, "  {plan}");
            }
        }
    }
}

fn format_measured(unit: Unit, value: crate::stats::Measured) -> String {
    let [low, high] = value.interval(0.95);
    unit.show_interval(value.value, 0.5 * (high - low), false)
}
