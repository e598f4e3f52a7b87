//! `warplight-client` once more: cargo hands the path of a binary only to tests of its own package.

use std::process::ExitCode;

fn main() -> ExitCode {
    warplight_client::cli::main()
}
