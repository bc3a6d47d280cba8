//! When a server is given up that sends nothing, or next to nothing.

use std::cell::Cell;
use std::env;
use std::pin::pin;
use std::str::FromStr;
use std::time::Duration;

use futures_util::future::{Either, select};
use tokio::time::sleep;

use super::fault::RemoteFault;

/// The setting that says how many bytes a second are asked for.
const RATE: &str = "POSEAUDIT_LEAST_RATE";

/// The setting that says over how many seconds.
const SECONDS: &str = "POSEAUDIT_PATIENCE";

/// How much is to come of what is fetched, in all and with all that is asked for again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Patience {
    /// Bytes a second; 0: it may take as long as it takes.
    rate: usize,
    /// Over so many seconds.
    seconds: u64,
}

impl Default for Patience {
    /// Twice the time is less than a minute, and after it a server is given up whenever it fell silent.
    fn default() -> Self {
        Self { rate: 1000, seconds: 28 }
    }
}

impl Patience {
    /// What the environment says.
    ///
    /// # Errors
    /// If it says something else than whole numbers.
    pub fn of_environment() -> Result<Self, RemoteFault> {
        let usual = Self::default();
        Ok(Self { rate: setting(RATE, usual.rate)?, seconds: setting(SECONDS, usual.seconds)? })
    }

    /// Does `work`, which counts in `came` the bytes that it gets, as long as enough of them come.
    ///
    /// # Errors
    /// What `work` returns, or if too few come.
    pub async fn watch<T>(
        self,
        came: &Cell<usize>,
        work: impl Future<Output = Result<T, RemoteFault>>,
    ) -> Result<T, RemoteFault> {
        match select(pin!(work), pin!(self.tire(came))).await {
            Either::Left((done, _)) => done,
            Either::Right((fault, _)) => Err(fault),
        }
    }

    /// Waits until too few bytes have come.
    async fn tire(self, came: &Cell<usize>) -> RemoteFault {
        let Self { rate, seconds } = self;
        loop {
            let before = came.get();
            // Second by second: what this thread does with the bytes does not count.
            for _ in 0..seconds.max(1) {
                sleep(Duration::from_secs(1)).await;
            }
            let bytes = came.get() - before;
            if (bytes as u64) < (rate as u64).saturating_mul(seconds) {
                return RemoteFault::Slow { bytes, seconds, rate };
            }
        }
    }
}

fn setting<T: FromStr>(name: &str, usual: T) -> Result<T, RemoteFault> {
    let Some(text) = env::var_os(name) else { return Ok(usual) };
    let number = text.to_str().and_then(|text| text.parse().ok());
    let cause = || format!("{name} is `{}`, which is no whole number", text.to_string_lossy());
    number.ok_or_else(|| RemoteFault::Address { cause: cause() })
}
