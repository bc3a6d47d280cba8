//! Detects credentials in the environment. Without them, a store's client would query the machine's
//! metadata service, which requires a setting.

use std::path::Path;

use object_store::aws::AmazonS3ConfigKey as S3;
use object_store::azure::AzureConfigKey as Azure;
use object_store::gcp::GoogleConfigKey as Google;

/// Permits the metadata service.
const METADATA_SERVICE: &str = "POSEAUDIT_METADATA_SERVICE";

const GCLOUD: &str = ".config/gcloud/application_default_credentials.json";

pub(super) fn has_s3_credentials(value: impl Fn(S3) -> Option<String>) -> bool {
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
    has_credentials(&sets, &[SkipSignature], value)
}

pub(super) fn has_google_credentials(value: impl Fn(Google) -> Option<String>) -> bool {
    use Google::{ApplicationCredentials, ServiceAccount, ServiceAccountKey, SkipSignature};
    let sets: [&[Google]; 3] = [&[ServiceAccount], &[ServiceAccountKey], &[ApplicationCredentials]];
    let is_logged_in =
        || std::env::var_os("HOME").is_some_and(|home| Path::new(&home).join(GCLOUD).is_file());
    has_credentials(&sets, &[SkipSignature], value) || is_logged_in()
}

pub(super) fn has_azure_credentials(value: impl Fn(Azure) -> Option<String>) -> bool {
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
    has_credentials(&sets, &[SkipSignature, UseAzureCli, UseEmulator], value)
}

/// Whether all keys of one of the `sets` have a value, one of the `switches` is on, or the metadata service
/// is permitted.
fn has_credentials<K: Copy>(
    sets: &[&[K]],
    switches: &[K],
    value: impl Fn(K) -> Option<String>,
) -> bool {
    let is_on =
        |text: &str| ["1", "true", "on", "yes", "y"].contains(&text.to_ascii_lowercase().as_str());
    sets.iter().any(|keys| keys.iter().all(|&key| value(key).is_some()))
        || switches.iter().any(|&key| value(key).is_some_and(|value| is_on(&value)))
        || std::env::var(METADATA_SERVICE).is_ok_and(|value| is_on(&value))
}
