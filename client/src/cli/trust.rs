//! Why a server elsewhere is believed, on the command line.

use super::Failure;
use crate::net::Endpoint;
use clap::Args;
use std::path::PathBuf;
use warplight_protocol::trust::Fingerprint;
use warplight_server::net::{TOKEN_VARIABLE, read_token};

/// Arguments of whatever connects to a server elsewhere.
#[derive(Debug, Args)]
pub(super) struct TrustArgs {
    /// SHA-256 of the server's certificate, as `serve --tls` prints it: the link is TLS, and no other certificate is
    /// taken.
    #[arg(long, value_name = "HEX", requires = "connect")]
    fingerprint: Option<Fingerprint>,
    /// The token that the server wants is in this file; without it that of the variable WARPLIGHT_TOKEN, if there is
    /// one.
    #[arg(long, value_name = "FILE", requires = "connect")]
    token_file: Option<PathBuf>,
    /// Say the token although nothing is encrypted.
    #[arg(long, requires = "connect")]
    insecure: bool,
}

impl TrustArgs {
    /// The server at `address`.
    pub(super) fn endpoint(&self, address: &str) -> Result<Endpoint, Failure> {
        let token =
            read_token(self.token_file.as_deref()).map_err(|error| Failure::Input(format!("token: {error}")))?;
        if !token.is_none() && self.fingerprint.is_none() && !self.insecure {
            return Err(Failure::Input(format!(
                "{address}: the token (--token-file or {TOKEN_VARIABLE}) would be sent unencrypted: \
                 expected --fingerprint, or --insecure"
            )));
        }
        Ok(Endpoint { address: address.to_owned(), fingerprint: self.fingerprint, token })
    }
}
