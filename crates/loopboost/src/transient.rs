//! Errors of the storage, as opposed to errors of a file.

use std::io::ErrorKind;

/// Error numbers without an [`ErrorKind`] of their own: input/output error, and remote input/output error (Linux).
const EIO: i32 = 5;
const EREMOTEIO: i32 = 121;

/// Whether an error says something about the storage, and nothing about the file: it must never cause a log to be left
/// out.
pub(crate) fn is_transient(error: &(dyn std::error::Error + 'static)) -> bool {
    let of_storage = |error: &std::io::Error| {
        use ErrorKind as K;
        let is_known = matches!(
            error.kind(),
            K::TimedOut
                | K::StaleNetworkFileHandle
                | K::Interrupted
                | K::WouldBlock
                | K::ResourceBusy
                | K::ConnectionAborted
                | K::ConnectionReset
                | K::ConnectionRefused
                | K::NotConnected
                | K::HostUnreachable
                | K::NetworkUnreachable
                | K::NetworkDown
                | K::OutOfMemory
        );
        is_known || matches!(error.raw_os_error(), Some(EIO | EREMOTEIO))
    };
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(of_storage)
}

#[cfg(test)]
mod tests {
    use ingest::IngestError;

    use super::*;

    #[test]
    fn errors_of_the_storage_are_not_errors_of_the_log() {
        let open = |source: std::io::Error| IngestError::Open { path: "a.mcap".into(), source };
        // 116: stale file handle, 110: timeout.
        for number in [EIO, 116, 110] {
            let error = open(std::io::Error::from_raw_os_error(number));
            assert!(is_transient(&error), "{number}");
        }
        for kind in [ErrorKind::NotFound, ErrorKind::PermissionDenied, ErrorKind::InvalidData] {
            assert!(!is_transient(&open(kind.into())), "{kind}");
        }
        assert!(!is_transient(&IngestError::Empty { path: "a.mcap".into() }));
    }
}
