//! Who may talk to whom: the token of a client, and the fingerprint of a server's certificate.
//!
//! Both are strings that people copy between two machines, so both are checked where they are read. There are no
//! names and no authorities: a client trusts the one certificate whose fingerprint it was given, and a server trusts
//! who knows its token. What is secret is never shown: `Debug` of a token says only that there is one.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use subtle::ConstantTimeEq;

/// A string is neither a token nor a fingerprint. Holds no part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TrustError {
    /// No token.
    #[error("a token has {least} to {most} visible ASCII characters", least = Token::BYTES.start(), most = Token::BYTES.end())]
    Token,
    /// No fingerprint.
    #[error("a fingerprint is the SHA-256 of a certificate: 64 hexadecimal digits, colons between them allowed")]
    Fingerprint,
}

/// What a client has to know to be served. Compared in a time that does not depend on where two differ; never shown.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct Token(String);

impl Token {
    /// Lengths of one. Below, it can be guessed; above, it is a file given by mistake.
    pub const BYTES: std::ops::RangeInclusive<usize> = 16..=256;
    /// None: the server asks for none, or the client has none.
    pub const NONE: Token = Token(String::new());

    /// A token of this text.
    pub fn new(text: &str) -> Result<Token, TrustError> {
        let token = Token(text.to_owned());
        if token.is_valid() && !token.is_none() { Ok(token) } else { Err(TrustError::Token) }
    }

    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        self.0.is_empty()
    }

    /// What a peer sent may be anything.
    pub(crate) fn is_valid(&self) -> bool {
        self.is_none() || (Token::BYTES.contains(&self.0.len()) && self.0.bytes().all(|byte| byte.is_ascii_graphic()))
    }

    /// As long as the longest, so that comparing tells no length either.
    fn padded(&self) -> [u8; *Token::BYTES.end()] {
        let mut padded = [0; *Token::BYTES.end()];
        for (to, from) in padded.iter_mut().zip(self.0.bytes()) {
            *to = from;
        }
        padded
    }
}

impl PartialEq for Token {
    fn eq(&self, other: &Token) -> bool {
        let is_equal = self.padded().ct_eq(&other.padded()) & self.0.len().ct_eq(&other.0.len());
        is_equal.into()
    }
}

impl Eq for Token {}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.is_none() { "Token(none)" } else { "Token(not shown)" })
    }
}

/// SHA-256 of a certificate's DER.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(pub [u8; 32]);

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl FromStr for Fingerprint {
    type Err = TrustError;

    fn from_str(text: &str) -> Result<Fingerprint, TrustError> {
        let digit = |letter: char| letter.to_digit(16).ok_or(TrustError::Fingerprint);
        let digits = text.chars().filter(|&letter| letter != ':').map(digit).collect::<Result<Vec<u32>, _>>()?;
        let bytes = digits.chunks(2).map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | *digit as u8));
        let bytes: Vec<u8> = bytes.collect();
        let has_whole_bytes = digits.len() % 2 == 0;
        bytes.try_into().ok().filter(|_| has_whole_bytes).map(Fingerprint).ok_or(TrustError::Fingerprint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_equal_to_itself_and_to_nothing_else() {
        let secret = Token::new("correct-horse-battery").unwrap();
        assert_eq!(secret, secret.clone());
        for other in ["correct-horse-batterx", "xorrect-horse-battery", "correct-horse-battery-", "correct-horse-batte"]
        {
            assert_ne!(secret, Token::new(other).unwrap(), "{other}");
        }
        assert_ne!(secret, Token::NONE);
        assert_eq!(Token::default(), Token::NONE);
    }

    #[test]
    fn a_token_is_never_shown() {
        let secret = Token::new("correct-horse-battery").unwrap();
        assert!(!format!("{secret:?} {secret:#?}").contains("horse"));
        assert!(!TrustError::Token.to_string().contains("horse"));
    }

    #[test]
    fn what_is_short_long_or_invisible_is_no_token() {
        for text in ["", "fifteen-letters", "with a space in it", "with\nnew-line-in-it", "größer-als-ascii-ist"] {
            assert_eq!(Token::new(text), Err(TrustError::Token), "{text}");
        }
        assert!(Token::new(&"x".repeat(16)).is_ok() && Token::new(&"x".repeat(256)).is_ok());
        assert_eq!(Token::new(&"x".repeat(257)), Err(TrustError::Token));
    }

    #[test]
    fn a_fingerprint_is_read_as_it_is_shown_and_as_others_show_it() {
        let fingerprint = Fingerprint(std::array::from_fn(|index| index as u8 * 7));
        assert_eq!(fingerprint.to_string().parse(), Ok(fingerprint));
        let pairs: Vec<String> = fingerprint.0.iter().map(|byte| format!("{byte:02X}")).collect();
        assert_eq!(pairs.join(":").parse(), Ok(fingerprint));
        for text in ["", "00", &"0".repeat(63), &"0".repeat(65), &"g".repeat(64)] {
            assert_eq!(text.parse::<Fingerprint>(), Err(TrustError::Fingerprint), "{text}");
        }
    }
}
