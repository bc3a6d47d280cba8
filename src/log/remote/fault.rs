//! Why an object cannot be read, and what to do about it.

use std::io;

/// Why an object in a store cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RemoteFault {
    /// This program was built without the clients of stores.
    #[error("this build reads no object storage")]
    NotBuilt,
    /// No store is reached by URLs that begin so.
    #[error("no store is reached by {scheme}://")]
    Scheme {
        /// What stands before `://`.
        scheme: String,
    },
    /// The URL, or a setting from the environment, cannot be followed.
    #[error("the address cannot be followed: {cause}")]
    Address {
        /// Why not.
        cause: String,
    },
    /// There is no such object.
    #[error("no such object")]
    NoObject,
    /// There is no such bucket or container.
    #[error("no such bucket")]
    NoBucket,
    /// There are no credentials.
    #[error("no credentials for {store}: {cause}")]
    NoCredentials {
        /// Which store.
        store: Store,
        /// Where they were sought last, and what was said there.
        cause: String,
    },
    /// The store does not accept the credentials, or they do not suffice.
    #[error("{store} refuses: {cause}")]
    Denied {
        /// Which store.
        store: Store,
        /// What it said.
        cause: String,
    },
    /// Nobody is reached at the address.
    #[error("cannot be reached: {cause}")]
    Unreachable {
        /// Why not.
        cause: String,
    },
    /// Nothing came for a time.
    #[error("no answer within {seconds} s")]
    Silent {
        /// How long was waited.
        seconds: u64,
    },
    /// Too little came for a time.
    #[error("{bytes} bytes came in {seconds} s, and {rate} a second are asked for")]
    Slow {
        /// How much.
        bytes: usize,
        /// In how long.
        seconds: u64,
        /// How much is asked for, bytes a second.
        rate: usize,
    },
    /// The connection broke off whenever the rest was asked for.
    #[error(
        "the connection broke off at byte {byte}, and again when the rest was asked for: {cause}"
    )]
    BrokenOff {
        /// The first byte that did not come.
        byte: u64,
        /// What was said last.
        cause: String,
    },
    /// The object was written anew meanwhile.
    #[error("the object changed while it was read")]
    Changed,
    /// The store answers with something else.
    #[error("the server says: {cause}")]
    Refused {
        /// What.
        cause: String,
    },
    /// The temporary file cannot be written.
    #[error("cannot be kept in {}: {source}", std::env::temp_dir().display())]
    Disk {
        /// What the operating system said.
        source: io::Error,
    },
    /// The file's index does not say what is in it, so that its reader came to what was not fetched.
    #[error("its index leaves out what is needed at byte {byte}")]
    Contradiction {
        /// That byte.
        byte: u64,
    },
}

/// A kind of store.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Store {
    /// Amazon S3, or another that speaks like it.
    S3,
    /// Google Cloud Storage.
    Google,
    /// Azure Blob Storage.
    Azure,
    /// A web server.
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
    /// What the reader can do.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NotBuilt => "build it with `--features full`, or download the log first",
            Self::Scheme { .. } => "name s3://, gs://, az://, abfss:// or https://, or a file",
            Self::Address { .. } => "name it as in s3://bucket/key, and see docs/remote.md",
            Self::NoObject => "see whether the key is spelt right",
            Self::NoBucket => "see whether the bucket is spelt right, and its region and endpoint",
            Self::NoCredentials { store, .. } => match store {
                Store::S3 => {
                    "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_SKIP_SIGNATURE=true for a \
                     public bucket, or POSEAUDIT_METADATA_SERVICE=true to ask the machine"
                }
                Store::Google => {
                    "set GOOGLE_SERVICE_ACCOUNT, GOOGLE_SKIP_SIGNATURE=true for a public bucket, or \
                     POSEAUDIT_METADATA_SERVICE=true to ask the machine"
                }
                Store::Azure => {
                    "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY, \
                     AZURE_SKIP_SIGNATURE=true for a public container, or \
                     POSEAUDIT_METADATA_SERVICE=true to ask the machine"
                }
                Store::Web => "name a URL that is signed",
            },
            Self::Denied { store, .. } => match store {
                Store::S3 => {
                    "check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN and what they \
                     may read"
                }
                Store::Google => "check GOOGLE_SERVICE_ACCOUNT and what it may read",
                Store::Azure => {
                    "check AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ACCOUNT_KEY and what they may \
                     read"
                }
                Store::Web => "name a URL that is signed, or an object that all may read",
            },
            Self::Unreachable { .. } => {
                "check the network, and AWS_ENDPOINT_URL or the host's name"
            }
            Self::Slow { .. } => {
                "try again, or set POSEAUDIT_LEAST_RATE to fewer bytes a second, or POSEAUDIT_PATIENCE \
                 to more seconds"
            }
            Self::Silent { .. } | Self::BrokenOff { .. } => "try again, or download the log first",
            Self::Changed => "try again when nobody writes it",
            Self::Refused { .. } => "see docs/remote.md for the settings of stores",
            Self::Disk { .. } => "make room, or let TMPDIR name another folder",
            Self::Contradiction { .. } => "fetch all of it by --verify",
        }
    }

    /// Whether it is the call that is wrong, and not the log or the way to it.
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
