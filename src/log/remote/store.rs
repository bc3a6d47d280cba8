//! From a URL to the client of its store. Credentials and endpoints come from the environment.

use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::http::HttpBuilder;
use object_store::path::Path as Key;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};

use super::fault::{RemoteFault, Store};
use super::{Address, cause};

/// How long a connection may take to stand.
const CONNECT: Duration = Duration::from_secs(5);

/// How often a request is repeated that was not answered, or with a fault of the server.
const RETRIES: usize = 5;

/// For how long.
const RETRIES_END: Duration = Duration::from_secs(30);

/// An object, and the client that reaches it.
pub(super) struct Source {
    pub(super) client: Arc<dyn ObjectStore>,
    pub(super) key: Key,
    pub(super) store: Store,
    /// The URL up to the key.
    pub(super) root: String,
}

impl Source {
    /// The object at `address`.
    pub(super) fn of(Address(url): &Address) -> Result<Self, RemoteFault> {
        let (scheme, rest) = url.split_once("://").unwrap_or_default();
        let (host, key) = rest.split_once('/').unwrap_or((rest, ""));
        let store = match scheme {
            "s3" | "s3a" => Store::S3,
            "gs" => Store::Google,
            "az" | "abfs" | "abfss" => Store::Azure,
            _ => Store::Web,
        };
        let invalid = |cause: String| RemoteFault::Address { cause };
        if host.is_empty() {
            return Err(invalid(format!("nothing stands behind {scheme}://")));
        }
        let root = format!("{scheme}://{host}/");
        let key = match store {
            // The whole URL is the client's root, so that nothing in it is written otherwise.
            Store::Web => Key::default(),
            _ => Key::parse(key).map_err(|error| invalid(error.to_string()))?,
        };
        let client: Result<Arc<dyn ObjectStore>, object_store::Error> = match store {
            Store::S3 => AmazonS3Builder::from_env()
                .with_client_options(options("AWS_"))
                .with_retry(retries())
                .with_url(&root)
                .build()
                .map(|client| Arc::new(client) as _),
            Store::Google => GoogleCloudStorageBuilder::from_env()
                .with_client_options(options("GOOGLE_"))
                .with_retry(retries())
                .with_url(&root)
                .build()
                .map(|client| Arc::new(client) as _),
            Store::Azure => MicrosoftAzureBuilder::from_env()
                .with_client_options(options("AZURE_"))
                .with_retry(retries())
                .with_url(&root)
                .build()
                .map(|client| Arc::new(client) as _),
            Store::Web => HttpBuilder::new()
                .with_client_options(plain_options().with_allow_http(true))
                .with_retry(retries())
                .with_url(url.split('#').next().unwrap_or_default())
                .build()
                .map(|client| Arc::new(client) as _),
        };
        let client = client.map_err(|error| invalid(cause::deepest(&error)))?;
        Ok(Self { client, key, store, root })
    }
}

/// How a client connects. Bodies take as long as they take; whether anything comes is seen where they
/// are read.
fn plain_options() -> ClientOptions {
    ClientOptions::new().with_timeout_disabled().with_connect_timeout(CONNECT)
}

/// The same as the variables say that begin with `prefix`, such as `AWS_ALLOW_HTTP`.
fn options(prefix: &str) -> ClientOptions {
    std::env::vars_os().fold(plain_options(), |options, (name, value)| {
        let name = name.to_str().and_then(|name| name.strip_prefix(prefix));
        let key = name.and_then(|name| name.to_ascii_lowercase().parse().ok());
        match (key, value.into_string()) {
            (Some(key), Ok(value)) => options.with_config(key, value),
            _ => options,
        }
    })
}

fn retries() -> RetryConfig {
    let backoff = BackoffConfig {
        init_backoff: Duration::from_millis(100),
        max_backoff: Duration::from_secs(5),
        base: 2.0,
    };
    RetryConfig { backoff, max_retries: RETRIES, retry_timeout: RETRIES_END }
}
