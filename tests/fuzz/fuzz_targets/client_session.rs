//! Whatever a server says and whenever: the client's session never panics, never hangs, says only what the protocol knows and
//! holds no more than its limits.

#![no_main]

use libfuzzer_sys::fuzz_target;
use warplight_tests::hostile;

fuzz_target!(|script: &[u8]| hostile::client_script(script));
