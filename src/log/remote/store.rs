//! Clients. Credentials and endpoints come from the environment.

use std::cell::Cell;
use std::iter;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use base64::prelude::{BASE64_STANDARD, Engine as _};
use object_store::aws::AmazonS3Builder;
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::http::HttpBuilder;
use object_store::path::Path as Key;
use object_store::{
    BackoffConfig, ClientOptions, HeaderMap, HeaderValue, ObjectStore, RetryConfig,
};
use percent_encoding::percent_decode_str;

use super::fault::{RemoteFault, Store};
use super::{Address, credentials, error_cause};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// After a server error or without an answer.
const MAX_RETRIES: usize = 5;

const RETRY_TIMEOUT: Duration = Duration::from_secs(30);

pub(super) struct Source {
    pub(super) client: Arc<dyn ObjectStore>,
    pub(super) key: Key,
    pub(super) store: Store,
    pub(super) root: String,
    pub(super) came: Rc<Cell<usize>>,
}

impl Source {
    pub(super) fn connect(Address(url): &Address) -> Result<Self, RemoteFault> {
        let (scheme, rest) = url.split_once("://").unwrap_or_default();
        let (host, key) = rest.split_once('/').unwrap_or((rest, ""));
        let is_account = scheme.starts_with("abfs") && !host.contains(':');
        let store = match scheme {
            "s3" | "s3a" => Store::S3,
            "gs" => Store::Google,
            "az" | "abfs" | "abfss" => Store::Azure,
            _ => Store::Web,
        };
        let invalid = |cause: String| RemoteFault::Address { cause };
        if host.is_empty() {
            return Err(invalid(format!("no bucket or host after {scheme}://")));
        }
        if store != Store::Web && !is_account && host.contains(['@', ':']) {
            let cause = "credentials must come from the environment, not from the URL";
            return Err(invalid(cause.to_owned()));
        }
        let root = format!("{scheme}://{host}/");
        let key = match store {
            // The whole URL is the client's root, so it is not re-encoded.
            Store::Web => Key::default(),
            _ => Key::parse(key).map_err(|error| invalid(error.to_string()))?,
        };
        let missing = || {
            let cause = "not set in the environment".to_owned();
            Err(RemoteFault::NoCredentials { store, cause })
        };
        let client: Result<Arc<dyn ObjectStore>, object_store::Error> = match store {
            Store::S3 => {
                let builder = AmazonS3Builder::from_env();
                if !credentials::has_s3_credentials(|key| builder.get_config_value(&key)) {
                    return missing();
                }
                builder
                    .with_client_options(options("AWS_"))
                    .with_retry(retries())
                    .with_url(&root)
                    .build()
                    .map(|client| Arc::new(client) as _)
            }
            Store::Google => {
                let builder = GoogleCloudStorageBuilder::from_env();
                if !credentials::has_google_credentials(|key| builder.get_config_value(&key)) {
                    return missing();
                }
                builder
                    .with_client_options(options("GOOGLE_"))
                    .with_retry(retries())
                    .with_url(&root)
                    .build()
                    .map(|client| Arc::new(client) as _)
            }
            Store::Azure => {
                let builder = MicrosoftAzureBuilder::from_env();
                if !credentials::has_azure_credentials(|key| builder.get_config_value(&key)) {
                    return missing();
                }
                builder
                    .with_client_options(options("AZURE_"))
                    .with_retry(retries())
                    .with_url(&root)
                    .build()
                    .map(|client| Arc::new(client) as _)
            }
            Store::Web => {
                let (url, login) = login(url.split('#').next().unwrap_or_default());
                HttpBuilder::new()
                    .with_client_options(
                        plain_options().with_allow_http(true).with_default_headers(login),
                    )
                    .with_retry(retries())
                    .with_url(url)
                    .build()
                    .map(|client| Arc::new(client) as _)
            }
        };
        let client = client.map_err(|error| invalid(error_cause::innermost_cause(&error)))?;
        Ok(Self { client, key, store, root, came: Rc::default() })
    }
}

/// Moves user and password from the URL to a header.
fn login(url: &str) -> (String, HeaderMap) {
    let mut headers = HeaderMap::new();
    let (scheme, rest) = url.split_once("://").unwrap_or_default();
    let end = rest.find(['/', '?']).unwrap_or(rest.len());
    let Some((user, host)) = rest[..end].rsplit_once('@') else { return (url.to_owned(), headers) };
    let (user, password) = user.split_once(':').unwrap_or((user, ""));
    let colon = iter::once(b':');
    let both: Vec<u8> =
        percent_decode_str(user).chain(colon).chain(percent_decode_str(password)).collect();
    // Base64 is always a valid header value.
    if let Ok(mut value) = HeaderValue::try_from(format!("Basic {}", BASE64_STANDARD.encode(both)))
    {
        value.set_sensitive(true);
        headers.insert("authorization", value);
    }
    (format!("{scheme}://{host}{}", &rest[end..]), headers)
}

/// No time limit for bodies: their reader detects stalls.
fn plain_options() -> ClientOptions {
    ClientOptions::new().with_timeout_disabled().with_connect_timeout(CONNECT_TIMEOUT)
}

/// Adds variables that start with `prefix`, such as `AWS_ALLOW_HTTP`.
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
    RetryConfig { backoff, max_retries: MAX_RETRIES, retry_timeout: RETRY_TIMEOUT }
}
