use std::error::Error;

use object_store::client::{HttpError, HttpErrorKind};

use super::fault::{RemoteFault, Store};

/// In characters.
const MAX_ANSWER_CHARS: usize = 200;

pub(super) fn remote_fault(error: &object_store::Error, store: Store) -> RemoteFault {
    let answer = error.to_string();
    let cause = || describe_response(&answer).unwrap_or_else(|| innermost_cause(error));
    match error {
        object_store::Error::NotFound { .. } if is_bucket(&answer) => RemoteFault::NoBucket,
        object_store::Error::NotFound { .. } => RemoteFault::NoObject,
        object_store::Error::PermissionDenied { .. }
        | object_store::Error::Unauthenticated { .. } => {
            RemoteFault::Denied { store, cause: cause() }
        }
        // Credentials were requested from the metadata service.
        _ if mentions_metadata_service(&answer) => RemoteFault::NoCredentials {
            store,
            cause: format!("{} at {METADATA}", innermost_cause(error)),
        },
        _ => match transport_error(error) {
            Some(HttpErrorKind::Connect) => {
                RemoteFault::Unreachable { cause: innermost_cause(error) }
            }
            _ => RemoteFault::Refused { cause: cause() },
        },
    }
}

/// The range starts after the end: the object is empty.
pub(super) fn is_range_beyond_end(error: &object_store::Error) -> bool {
    status(&error.to_string()).is_some_and(|status| status.starts_with("416"))
}

const METADATA: &str = "the machine's metadata service";

fn mentions_metadata_service(answer: &str) -> bool {
    ["169.254.169.254", "169.254.170.2", "metadata.google.internal", "metadata.google"]
        .iter()
        .any(|host| answer.contains(host))
}

fn is_bucket(answer: &str) -> bool {
    ["NoSuchBucket", "ContainerNotFound", "specified bucket does not exist"]
        .iter()
        .any(|code| answer.contains(code))
}

fn transport_error(error: &object_store::Error) -> Option<HttpErrorKind> {
    causes(error).find_map(|cause| cause.downcast_ref::<HttpError>()).map(HttpError::kind)
}

fn describe_response(answer: &str) -> Option<String> {
    let status = status(answer)?;
    let between = |tag: &str| {
        let (_, rest) = answer.split_once(&format!("<{tag}>"))?;
        rest.split_once(&format!("</{tag}>")).map(|(inner, _)| line(inner))
    };
    Some(match (between("Code"), between("Message")) {
        (Some(code), Some(message)) => format!("{status}, {code} ({message})"),
        (Some(code), None) => format!("{status}, {code}"),
        _ => status.to_owned(),
    })
}

fn status(answer: &str) -> Option<&str> {
    let (_, rest) = answer.split_once("non-2xx status code: ")?;
    rest.split(':').next().map(str::trim)
}

/// Innermost cause; outer errors repeat it with the URL.
pub(super) fn innermost_cause(error: &(dyn Error + 'static)) -> String {
    causes(error).last().map(|cause| line(&cause.to_string())).unwrap_or_default()
}

fn causes<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |&error| error.source())
}

fn line(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    let text = words.join(" ");
    let end = text.char_indices().nth(MAX_ANSWER_CHARS).map_or(text.len(), |(end, _)| end);
    text[..end].trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_of_a_store_are_shown_in_one_line() {
        let answer = "Error performing GET http://host/key in 3ms - Server returned non-2xx status \
                    code: 403 Forbidden: <?xml?>\n<Error><Code>SignatureDoesNotMatch</Code>\n\
                    <Message>The signature\n does not match.</Message></Error>";
        let expected = "403 Forbidden, SignatureDoesNotMatch (The signature does not match)";
        assert_eq!(describe_response(answer).as_deref(), Some(expected));
        assert_eq!(
            describe_response("… non-2xx status code: 400 Bad Request: ").as_deref(),
            Some("400 Bad Request")
        );
        assert_eq!(describe_response("connection refused"), None);
        assert_eq!(line(&"ä".repeat(300)).chars().count(), MAX_ANSWER_CHARS);
    }
}
