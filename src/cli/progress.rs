//! How far a log was read, on a terminal.

use std::io::{self, IsTerminal};
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use poseaudit::log::Progress;

/// Nobody needs a bar for what is done sooner.
const PATIENCE: Duration = Duration::from_secs(1);
const REDRAW: Duration = Duration::from_millis(100);

/// Does `work`, and shows on stderr how far it has come where that takes more than a second and
/// somebody watches.
pub fn watched<T>(work: impl FnOnce(Arc<Progress>) -> T) -> T {
    let progress = Arc::new(Progress::default());
    if !io::stderr().is_terminal() {
        return work(progress);
    }
    let (done, waits) = mpsc::channel::<()>();
    let watcher = thread::spawn({
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
    let result = work(progress);
    drop(done);
    // A watcher that failed has nothing to say about the work.
    let _ = watcher.join();
    result
}

fn bar() -> ProgressBar {
    let template = "{msg:8} {bar:40} {bytes} of {total_bytes}, {elapsed}";
    let style = ProgressStyle::with_template(template);
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn show(bar: &ProgressBar, progress: &Progress) {
    let (read, total) = (progress.read(), progress.total());
    bar.set_length(total);
    bar.set_message(if total > 0 && read == total { "auditing" } else { "reading" });
    bar.set_position(read);
}
