//! Progress of a log, and of a fleet.

use std::io::{self, IsTerminal};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{HumanBytes, ProgressBar, ProgressDrawTarget, ProgressStyle};
use poseaudit::fleet::Course;
use poseaudit::log::Progress;

use super::say;

/// Before a bar is shown.
const PATIENCE: Duration = Duration::from_secs(1);
const REDRAW: Duration = Duration::from_millis(100);

/// Shows a bar on stderr after a second if that is a terminal.
pub fn watched<T>(work: impl FnOnce(Arc<Progress>) -> T) -> T {
    let progress = Arc::new(Progress::default());
    if say::is_quiet() || !io::stderr().is_terminal() {
        return timed(progress, work);
    }
    let (done, waits) = mpsc::channel::<()>();
    let watcher = thread::Builder::new().spawn({
        let progress = Arc::clone(&progress);
        move || {
            if waits.recv_timeout(PATIENCE) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            let bar = bar();
            while waits.recv_timeout(REDRAW) == Err(RecvTimeoutError::Timeout) {
                show(&bar, &progress);
            }
            bar.finish_and_clear();
        }
    });
    let result = timed(progress, work);
    drop(done);
    // A failed progress thread does not matter.
    let _ = watcher.map(thread::JoinHandle::join);
    result
}

/// Reports the duration in verbose mode.
fn timed<T>(progress: Arc<Progress>, work: impl FnOnce(Arc<Progress>) -> T) -> T {
    let began = Instant::now();
    let result = work(Arc::clone(&progress));
    say::detail("read", || {
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

/// Without a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// A bar on a terminal, otherwise occasional lines.
pub struct Logs {
    bar: Option<ProgressBar>,
    began: Instant,
    told: Mutex<Instant>,
}

impl Logs {
    pub fn new(total: usize) -> Self {
        let bar = (!say::is_quiet() && io::stderr().is_terminal()).then(|| {
            let template = "{bar:30} {pos} of {len} logs, {per_sec}, {eta} left";
            let style = ProgressStyle::with_template(template);
            let target = ProgressDrawTarget::stderr();
            let bar = ProgressBar::with_draw_target(Some(total as u64), target);
            bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        let began = Instant::now();
        Self { bar, began, told: Mutex::new(began) }
    }

    pub fn show(&self, course: Course) {
        if let Some(bar) = &self.bar {
            bar.set_position(course.done as u64);
            return;
        }
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if say::is_quiet() || told.elapsed() < LINE_EVERY {
            return;
        }
        *told = Instant::now();
        let Course { done, total, audited } = course;
        let rate = audited as f64 / self.began.elapsed().as_secs_f64();
        let left = match rate > 0.0 {
            true => format!(", {:.0} s left", (total - done) as f64 / rate),
            false => String::new(),
        };
        eprintln!("{done} of {total} logs, {rate:.2}/s{left}");
    }

    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
