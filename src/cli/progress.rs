//! Progress of a log, and of a fleet.

use std::io::{self, IsTerminal};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{HumanBytes, ProgressBar, ProgressDrawTarget, ProgressStyle};
use poseaudit::fleet::FleetProgress;
use poseaudit::log::Progress;

use super::messages;

const BAR_DELAY: Duration = Duration::from_secs(1);
const REDRAW_INTERVAL: Duration = Duration::from_millis(100);

/// Shows a bar on stderr after a second if that is a terminal.
pub fn with_progress<T>(work: impl FnOnce(Arc<Progress>) -> T) -> T {
    let progress = Arc::new(Progress::default());
    if messages::is_quiet() || !io::stderr().is_terminal() {
        return with_timing(progress, work);
    }
    let (done, finished) = mpsc::channel::<()>();
    let watcher = thread::Builder::new().spawn({
        let progress = Arc::clone(&progress);
        move || {
            if finished.recv_timeout(BAR_DELAY) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            let bar = bar();
            while finished.recv_timeout(REDRAW_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                show(&bar, &progress);
            }
            bar.finish_and_clear();
        }
    });
    let result = with_timing(progress, work);
    drop(done);
    // A failed progress thread does not matter.
    let _ = watcher.map(thread::JoinHandle::join);
    result
}

/// Reports the duration in verbose mode.
fn with_timing<T>(progress: Arc<Progress>, work: impl FnOnce(Arc<Progress>) -> T) -> T {
    let began = Instant::now();
    let result = work(Arc::clone(&progress));
    messages::print_detail("read", || {
        format!("{}, {:.2} s", HumanBytes(progress.read()), began.elapsed().as_secs_f64())
    });
    result
}

fn bar() -> ProgressBar {
    let template = "{msg:10} {bar:40} {bytes} of {total_bytes}, {elapsed}";
    let style = ProgressStyle::with_template(template);
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn show(bar: &ProgressBar, progress: &Progress) {
    let (read, total) = (progress.read(), progress.total());
    bar.set_length(total);
    bar.set_message(progress.activity());
    bar.set_position(read);
}

/// Interval without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// A bar on a terminal, otherwise occasional lines.
pub struct FleetProgressBar {
    bar: Option<ProgressBar>,
    began: Instant,
    last_line: Mutex<Instant>,
}

impl FleetProgressBar {
    pub fn new(total: usize) -> Self {
        let bar = (!messages::is_quiet() && io::stderr().is_terminal()).then(|| {
            let template = "{bar:30} {pos} of {len} logs, {per_sec}, {eta} left";
            let style = ProgressStyle::with_template(template);
            let target = ProgressDrawTarget::stderr();
            let bar = ProgressBar::with_draw_target(Some(total as u64), target);
            bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        let began = Instant::now();
        Self { bar, began, last_line: Mutex::new(began) }
    }

    pub fn show(&self, course: FleetProgress) {
        if let Some(bar) = &self.bar {
            bar.set_position(course.done as u64);
            return;
        }
        let mut last_line = self.last_line.lock().unwrap_or_else(PoisonError::into_inner);
        if messages::is_quiet() || last_line.elapsed() < LINE_INTERVAL {
            return;
        }
        *last_line = Instant::now();
        let FleetProgress { done, total, audited } = course;
        let rate = audited as f64 / self.began.elapsed().as_secs_f64();
        let remaining = match rate > 0.0 {
            true => format!(", {:.0} s left", (total - done) as f64 / rate),
            false => String::new(),
        };
        eprintln!("{done} of {total} logs, {rate:.2}/s{remaining}");
    }

    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
