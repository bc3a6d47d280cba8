use std::io;

/// Fault of reading an object in a store.
#[derive(Debug, thiserror::Error)]
pub enum RemoteFault {
    /// Built without clients for stores.
    #[error("this build cannot read object storage")]
    NotBuilt,
    /// Unsupported URL scheme.
    #[error("unsupported URL scheme {scheme}://")]
    Scheme {
        /// Text before `://`.
        scheme: String,
    },
    /// Invalid URL or setting in the environment.
    #[error("invalid address: {cause}")]
    Address {
        /// Reason.
        cause: String,
    },
    /// No such object.
    #[error("no such object")]
    NoObject,
    /// No such bucket or container.
    #[error("no such bucket")]
    NoBucket,
    /// Missing credentials.
    #[error("no credentials for {store}: {cause}")]
    NoCredentials {
        /// Store.
        store: Store,
        /// Last source tried, and its answer.
        cause: String,
    },
    /// Credentials rejected or insufficient.
    #[error("{store} refuses: {cause}")]
    Denied {
        /// Store.
        store: Store,
        /// Its answer.
        cause: String,
    },
    /// Address cannot be reached.
    #[error("cannot be reached: {cause}")]
    Unreachable {
        /// Reason.
        cause: String,
    },
    /// No data within a time limit.
    #[error("no answer within {seconds} s")]
    Silent {
        /// Limit, s.
        seconds: u64,
    },
    /// Too little data within a time limit.
    #[error("received {bytes} bytes in {seconds} s, below the minimum of {rate} per second")]
    Slow {
        /// Bytes received.
        bytes: usize,
        /// Time, s.
        seconds: u64,
        /// Minimum rate, bytes per second.
        rate: usize,
    },
    /// The connection broke off on every attempt.
    #[error("the connection broke off at byte {byte}, and again on every retry: {cause}")]
    BrokenOff {
        /// First missing byte.
        byte: u64,
        /// Last error.
        cause: String,
    },
    /// Object rewritten during the download.
    #[error("the object changed while it was read")]
    Changed,
    /// Any other answer.
    #[error("the server answered: {cause}")]
    Refused {
        /// Answer.
        cause: String,
    },
    /// The temporary file cannot be written.
    #[error("cannot be stored in {}: {source}", std::env::temp_dir().display())]
    Disk {
        /// Operating system error.
        source: io::Error,
    },
    /// Incomplete index: the reader needs data that was not fetched.
    #[error("its index omits data that is needed at byte {byte}")]
    Contradiction {
        /// Offset of the missing data.
        byte: u64,
    },
}

/// Kind of store.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Store {
    /// Amazon S3 or compatible.
    S3,
    /// Google Cloud Storage.
    Google,
    /// Azure Blob Storage.
    Azure,
    /// Web server.
    Web,
}

impl std::fmt::Display for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Store::S3 => "S3",
            Store::Google => "Google Cloud Storage",
            Store::Azure => "Azure",
            Store::Web => "the server",
        })
    }
}

impl RemoteFault {
    /// Advice for the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NotBuilt => "build it with `--features full`, or download the log first",
            Self::Scheme { .. } => "use s3://, gs://, az://, abfss:// or https://, or a file",
            Self::Address { .. } => "write it as s3://bucket/key; see docs/remote.md",
            Self::NoObject => "check the spelling of the key",
            Self::NoBucket => "check the spelling of the bucket, and its region and endpoint",
            Self::NoCredentials { store, .. } => match store {
                Store::S3 => {
                    "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_SKIP_SIGNATURE=true for a public \
                     bucket, or POSEAUDIT_METADATA_SERVICE=true to use the metadata service"
                }
                Store::Google => {
                    "set GOOGLE_SERVICE_ACCOUNT, GOOGLE_SKIP_SIGNATURE=true for a public bucket, or \
                     POSEAUDIT_METADATA_SERVICE=true to use the metadata service"
                }
                Store::Azure => {
                    "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY, AZURE_SKIP_SIGNATURE=true \
                     for a public container, or POSEAUDIT_METADATA_SERVICE=true to use the metadata service"
                }
                Store::Web => "use a signed URL",
            },
            Self::Denied { store, .. } => match store {
                Store::S3 => {
                    "check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN and their permissions"
                }
                Store::Google => "check GOOGLE_SERVICE_ACCOUNT and its permissions",
                Store::Azure => {
                    "check AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ACCOUNT_KEY and their permissions"
                }
                Store::Web => "use a signed URL or a public object",
            },
            Self::Unreachable { .. } => "check the network, and AWS_ENDPOINT_URL or the host name",
            Self::Slow { .. } => {
                "try again, or lower POSEAUDIT_LEAST_RATE (bytes per second), or raise POSEAUDIT_PATIENCE \
                 (seconds)"
            }
            Self::Silent { .. } | Self::BrokenOff { .. } => "try again, or download the log first",
            Self::Changed => "try again when the object is no longer being written",
            Self::Refused { .. } => "see docs/remote.md for the settings of stores",
            Self::Disk { .. } => "free disk space, or set TMPDIR to another folder",
            Self::Contradiction { .. } => "fetch the whole file with --verify",
        }
    }

    /// Whether the call is wrong, not the log or the connection.
    pub fn is_of_the_call(&self) -> bool {
        matches!(
            self,
            Self::NotBuilt
                | Self::Scheme { .. }
                | Self::Address { .. }
                | Self::NoObject
                | Self::NoBucket
                | Self::Disk { .. }
        )
    }
}
