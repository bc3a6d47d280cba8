use std::cell::Cell;
use std::env;
use std::pin::pin;
use std::str::FromStr;
use std::time::Duration;

use futures_util::future::{Either, select};
use tokio::time::sleep;

use super::fault::RemoteFault;

/// Environment variable, bytes per second.
const RATE_VARIABLE: &str = "POSEAUDIT_LEAST_RATE";

/// Environment variable, seconds.
const PERIOD_VARIABLE: &str = "POSEAUDIT_PATIENCE";

/// Averaged over all requests of a download.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MinimumRate {
    /// Bytes per second; 0 for no minimum.
    rate: usize,
    /// Averaging time, s.
    seconds: u64,
}

impl Default for MinimumRate {
    /// Two periods take less than a minute and end after all timeouts of a silent server.
    fn default() -> Self {
        Self { rate: 1000, seconds: 28 }
    }
}

impl MinimumRate {
    /// # Errors
    /// If a setting is not a whole number.
    pub fn from_environment() -> Result<Self, RemoteFault> {
        let usual = Self::default();
        Ok(Self {
            rate: setting(RATE_VARIABLE, usual.rate)?,
            seconds: setting(PERIOD_VARIABLE, usual.seconds)?,
        })
    }

    /// Runs `work`, which counts received bytes in `came`.
    ///
    /// # Errors
    /// If `work` fails, or the rate is too low.
    pub async fn watch<T>(
        self,
        came: &Cell<usize>,
        work: impl Future<Output = Result<T, RemoteFault>>,
    ) -> Result<T, RemoteFault> {
        match select(pin!(work), pin!(self.wait_until_slow(came))).await {
            Either::Left((done, _)) => done,
            Either::Right((fault, _)) => Err(fault),
        }
    }

    async fn wait_until_slow(self, came: &Cell<usize>) -> RemoteFault {
        let Self { rate, seconds } = self;
        loop {
            let before = came.get();
            // In steps of one second: time spent on the data does not count.
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
    let cause = || format!("{name} is `{}`, not a whole number", text.to_string_lossy());
    number.ok_or_else(|| RemoteFault::Address { cause: cause() })
}
