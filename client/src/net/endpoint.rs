//! Where the server is and why it is believed: address, fingerprint, token. One way to connect, for the first time
//! and after a loss.
//!
//! With a fingerprint the link is TLS 1.3, and the certificate whose SHA-256 that is is the only one taken, whatever it says of
//! names and dates; its signature over the handshake is checked as ever, so that a copied certificate is of no use
//! without its key. Nothing of an earlier connection is used again. Without a fingerprint the link is plain TCP.

use ring::digest::{SHA256, digest};
use std::io;
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::client::Resumption;
use tokio_rustls::rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring::default_provider, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error as TlsError, OtherError, PeerIncompatible,
    SignatureScheme,
};
use warplight_protocol::Token;
use warplight_protocol::trust::Fingerprint;

/// A server.
#[derive(Clone, Debug)]
pub struct Endpoint {
    /// Host and port.
    pub address: String,
    /// Of its certificate; none for a link without TLS.
    pub fingerprint: Option<Fingerprint>,
    /// What it wants to hear.
    pub token: Token,
}

/// A link to it.
pub trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// The server has another certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the server's certificate has the fingerprint {found}, not the one given")]
pub struct OtherCertificate {
    /// What it has instead.
    pub found: Fingerprint,
}

impl Endpoint {
    /// A server that asks for nothing and proves nothing.
    pub fn plain(address: impl Into<String>) -> Endpoint {
        Endpoint { address: address.into(), fingerprint: None, token: Token::NONE }
    }

    /// Connects; TLS is done when the link is there.
    pub async fn open(&self) -> io::Result<Box<dyn Stream>> {
        let socket = TcpStream::connect(&self.address).await?;
        socket.set_nodelay(true)?;
        let Some(fingerprint) = self.fingerprint else {
            return Ok(Box::new(socket));
        };
        let connector = TlsConnector::from(Arc::new(config(fingerprint).map_err(io::Error::other)?));
        let name = ServerName::try_from("warplight").map_err(io::Error::other)?;
        Ok(Box::new(connector.connect(name, socket).await?))
    }
}

/// Whether an attempt failed for a reason that stays: another certificate.
pub(super) fn other_certificate(error: &io::Error) -> Option<OtherCertificate> {
    match error.get_ref()?.downcast_ref::<TlsError>()? {
        TlsError::InvalidCertificate(CertificateError::Other(OtherError(source))) => source.downcast_ref().copied(),
        _ => None,
    }
}

fn config(fingerprint: Fingerprint) -> Result<ClientConfig, TlsError> {
    let provider = Arc::new(default_provider());
    let mut config = ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&TLS13])?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Pinned { fingerprint, provider }))
        .with_no_client_auth();
    config.resumption = Resumption::disabled();
    config.enable_sni = false;
    Ok(config)
}

/// Takes one certificate and no other.
#[derive(Debug)]
struct Pinned {
    fingerprint: Fingerprint,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, TlsError> {
        let mut found = Fingerprint([0; 32]);
        found.0.copy_from_slice(digest(&SHA256, end_entity).as_ref());
        if found == self.fingerprint {
            return Ok(ServerCertVerified::assertion());
        }
        Err(TlsError::InvalidCertificate(CertificateError::Other(OtherError(Arc::new(OtherCertificate { found })))))
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        Err(TlsError::PeerIncompatible(PeerIncompatible::Tls12NotOffered))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}
