//! Who the server is: a certificate that it makes itself, known by its fingerprint.
//!
//! There is no authority to ask: a client is given the SHA-256 of the certificate's DER by whoever started the server, and
//! takes nothing else. So the certificate has no useful name and does not expire. Kept in two files it survives a
//! restart, and clients with it; made anew, each start needs its fingerprint carried over again.
//!
//! TLS 1.3 only (RFC 8446), by rustls over ring: ring is built with a C compiler alone, where aws-lc wants more on
//! some machines. No tickets and no early data, so that what was recorded opens nothing.

use ring::digest::{SHA256, digest};
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::net::TcpStream;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::NoServerSessionStorage;
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{self, ServerConfig};
use tokio_rustls::{TlsAcceptor, server::TlsStream};
use warplight_protocol::trust::Fingerprint;

/// What TLS may hold of what a session has handed over: a record.
const HELD_BYTES: usize = 16 << 10;

/// A certificate and its key.
#[derive(Clone)]
pub struct Identity {
    acceptor: TlsAcceptor,
    fingerprint: Fingerprint,
}

impl fmt::Debug for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Identity({})", self.fingerprint)
    }
}

/// There is no identity. Holds nothing of a key.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// Not to be read or written.
    #[error("{path}: {source}")]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not what it should be.
    #[error("{path}: expected a PEM file with {expected}")]
    Pem {
        /// Which.
        path: PathBuf,
        /// What should be in it.
        expected: &'static str,
    },
    /// One file is there, the other is not.
    #[error("{path}: not there, but {other} is: expected both, or neither to make both")]
    Half {
        /// The one that is not.
        path: PathBuf,
        /// The one that is.
        other: PathBuf,
    },
    /// They do not fit together, or the library refuses them.
    #[error("certificate and key: {0}")]
    Tls(#[from] rustls::Error),
    /// A certificate could not be made.
    #[error("making a certificate: {0}")]
    Making(#[from] rcgen::Error),
}

impl Identity {
    /// One that lasts as long as this process.
    pub fn generate() -> Result<Identity, IdentityError> {
        let made = rcgen::generate_simple_self_signed(vec!["warplight".to_owned()])?;
        let key = PrivateKeyDer::try_from(made.signing_key.serialize_der());
        let key = key.map_err(|error| rustls::Error::General(error.to_owned()))?;
        Identity::new(made.cert.der().clone(), key)
    }

    /// The one kept in two PEM files; where neither is there, one is made and kept.
    pub fn kept(certificate: &Path, key: &Path) -> Result<Identity, IdentityError> {
        match (certificate.exists(), key.exists()) {
            (true, true) => {}
            (false, false) => {
                let made = rcgen::generate_simple_self_signed(vec!["warplight".to_owned()])?;
                write_new(key, &made.signing_key.serialize_pem())?;
                write_new(certificate, &made.cert.pem())?;
            }
            (true, false) => return Err(IdentityError::Half { path: key.into(), other: certificate.into() }),
            (false, true) => return Err(IdentityError::Half { path: certificate.into(), other: key.into() }),
        }
        let pem = |path: &Path, expected| {
            let path = path.to_owned();
            move |_| IdentityError::Pem { path, expected }
        };
        let read =
            |path: &Path| std::fs::read(path).map_err(|source| IdentityError::File { path: path.to_owned(), source });
        let first = CertificateDer::from_pem_slice(&read(certificate)?).map_err(pem(certificate, "a certificate"))?;
        let secret = PrivateKeyDer::from_pem_slice(&read(key)?).map_err(pem(key, "a private key"))?;
        Identity::new(first, secret)
    }

    fn new(certificate: CertificateDer<'static>, key: PrivateKeyDer<'static>) -> Result<Identity, IdentityError> {
        let fingerprint = fingerprint_of(&certificate);
        let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
            .with_protocol_versions(&[&TLS13])?
            .with_no_client_auth()
            .with_single_cert(vec![certificate], key)?;
        config.send_tls13_tickets = 0;
        config.session_storage = Arc::new(NoServerSessionStorage {});
        Ok(Identity { acceptor: TlsAcceptor::from(Arc::new(config)), fingerprint })
    }

    /// What a client has to be given.
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    pub(super) async fn accept(&self, socket: TcpStream) -> io::Result<TlsStream<TcpStream>> {
        let mut stream = self.acceptor.accept(socket).await?;
        stream.get_mut().1.set_buffer_limit(Some(HELD_BYTES));
        Ok(stream)
    }
}

/// SHA-256 of a certificate.
fn fingerprint_of(certificate: &CertificateDer<'_>) -> Fingerprint {
    let mut bytes = [0; 32];
    bytes.copy_from_slice(digest(&SHA256, certificate).as_ref());
    Fingerprint(bytes)
}

/// A file that was not there, for its owner's eyes only.
fn write_new(path: &Path, text: &str) -> Result<(), IdentityError> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|source| IdentityError::File { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_identity_is_the_same_after_a_restart_and_a_made_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        let first = Identity::kept(&certificate, &key).unwrap();
        assert_eq!(Identity::kept(&certificate, &key).unwrap().fingerprint(), first.fingerprint());
        assert_ne!(Identity::generate().unwrap().fingerprint(), first.fingerprint());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(std::fs::metadata(&key).unwrap().permissions().mode() & 0o777, 0o600);
        }
        let shown = format!("{first:?}");
        let secret = std::fs::read_to_string(&key).unwrap();
        assert!(secret.lines().filter(|line| !line.starts_with("---")).all(|line| !shown.contains(line)));
    }

    #[test]
    fn half_an_identity_or_a_broken_one_is_refused_by_file() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        Identity::kept(&certificate, &key).unwrap();
        let other = folder.path().join("other.pem");
        let error = Identity::kept(&certificate, &other).unwrap_err().to_string();
        assert!(error.contains("other.pem: not there") && error.contains("cert.pem"), "{error}");
        std::fs::write(&other, "no pem").unwrap();
        let error = Identity::kept(&certificate, &other).unwrap_err().to_string();
        assert!(error.contains("other.pem") && error.contains("a private key"), "{error}");
        let third = folder.path().join("third.pem");
        Identity::kept(&folder.path().join("fourth.pem"), &third).unwrap();
        assert!(matches!(Identity::kept(&certificate, &third), Err(IdentityError::Tls(_))), "keys of two");
    }
}
