//! Whether the environment names credentials. Where it does not, a store's client would ask the machine's
//! metadata service for them, which is done only where a setting says so.

use std::path::Path;

use object_store::aws::AmazonS3ConfigKey as S3;
use object_store::azure::AzureConfigKey as Azure;
use object_store::gcp::GoogleConfigKey as Google;

/// The setting with which the machine is asked.
const METADATA_SERVICE: &str = "POSEAUDIT_METADATA_SERVICE";

/// What gcloud writes where somebody logs in with it, below the home folder.
const GCLOUD: &str = ".config/gcloud/application_default_credentials.json";

/// Whether a client of S3 finds credentials by itself.
pub(super) fn s3(value: impl Fn(S3) -> Option<String>) -> bool {
    use S3::{
        AccessKeyId, ContainerAuthorizationTokenFile, ContainerCredentialsFullUri,
        ContainerCredentialsRelativeUri, RoleArn, SecretAccessKey, SkipSignature,
        WebIdentityTokenFile,
    };
    let sets: [&[S3]; 5] = [
        &[AccessKeyId],
        &[SecretAccessKey],
        &[WebIdentityTokenFile, RoleArn],
        &[ContainerCredentialsRelativeUri],
        &[ContainerCredentialsFullUri, ContainerAuthorizationTokenFile],
    ];
    are_named(&sets, &[SkipSignature], value)
}

/// The same of Google's.
pub(super) fn google(value: impl Fn(Google) -> Option<String>) -> bool {
    use Google::{ApplicationCredentials, ServiceAccount, ServiceAccountKey, SkipSignature};
    let sets: [&[Google]; 3] = [&[ServiceAccount], &[ServiceAccountKey], &[ApplicationCredentials]];
    let is_logged_in =
        || std::env::var_os("HOME").is_some_and(|home| Path::new(&home).join(GCLOUD).is_file());
    are_named(&sets, &[SkipSignature], value) || is_logged_in()
}

/// The same of Azure's.
pub(super) fn azure(value: impl Fn(Azure) -> Option<String>) -> bool {
    use Azure::{
        AccessKey, AuthorityId, ClientId, ClientSecret, FabricClusterIdentifier,
        FabricSessionToken, FabricTokenServiceUrl, FabricWorkloadHost, FederatedTokenFile, SasKey,
        SkipSignature, Token, UseAzureCli, UseEmulator,
    };
    let sets: [&[Azure]; 6] = [
        &[AccessKey],
        &[Token],
        &[SasKey],
        &[ClientId, AuthorityId, FederatedTokenFile],
        &[ClientId, AuthorityId, ClientSecret],
        &[FabricTokenServiceUrl, FabricWorkloadHost, FabricSessionToken, FabricClusterIdentifier],
    ];
    are_named(&sets, &[SkipSignature, UseAzureCli, UseEmulator], value)
}

/// Whether all of one of the `sets` have a value, one of the `switches` is on, or the machine may be asked.
fn are_named<K: Copy>(sets: &[&[K]], switches: &[K], value: impl Fn(K) -> Option<String>) -> bool {
    let is_on =
        |text: &str| ["1", "true", "on", "yes", "y"].contains(&text.to_ascii_lowercase().as_str());
    sets.iter().any(|keys| keys.iter().all(|&key| value(key).is_some()))
        || switches.iter().any(|&key| value(key).is_some_and(|value| is_on(&value)))
        || std::env::var(METADATA_SERVICE).is_ok_and(|value| is_on(&value))
}
