//! Where a token is read from: a file, or the environment. Never from the command line, which everybody on a machine
//! can see. Both programs read it here.

use std::io;
use std::path::{Path, PathBuf};
use warplight_protocol::Token;
use warplight_protocol::trust::TrustError;

/// The variable with the token, where no file is named.
pub const TOKEN_VARIABLE: &str = "WARPLIGHT_TOKEN";

/// Where a token should be there is none. Holds no part of it.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// Not to be read.
    #[error("{path}: {source}")]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not what it should be.
    #[error("{place}: {source}")]
    Content {
        /// File or variable.
        place: String,
        /// What was expected.
        source: TrustError,
    },
}

/// The token of this file, or that of [`TOKEN_VARIABLE`], or none. White space around it does not count.
pub fn read_token(file: Option<&Path>) -> Result<Token, TokenError> {
    let content = |place: String| move |source| TokenError::Content { place, source };
    if let Some(path) = file {
        let bytes = std::fs::read(path).map_err(|source| TokenError::File { path: path.to_owned(), source })?;
        let text = String::from_utf8_lossy(&bytes);
        return Token::new(text.trim()).map_err(content(path.display().to_string()));
    }
    match std::env::var_os(TOKEN_VARIABLE) {
        Some(text) => Token::new(text.to_string_lossy().trim()).map_err(content(TOKEN_VARIABLE.to_owned())),
        None => Ok(Token::NONE),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_and_refused_without_being_quoted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        std::fs::write(&path, "correct-horse-battery\n").unwrap();
        assert_eq!(read_token(Some(&path)).unwrap(), Token::new("correct-horse-battery").unwrap());
        std::fs::write(&path, "tooshort").unwrap();
        let error = read_token(Some(&path)).unwrap_err();
        assert!(error.to_string().contains("token: a token has 16 to 256"), "{error}");
        assert!(!format!("{error} {error:?}").contains("tooshort"));
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(read_token(Some(&path)), Err(TokenError::File { .. })));
    }
}
