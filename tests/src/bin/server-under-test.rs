//! `warplight-server` once more: cargo hands the path of a binary only to tests of its own package.

use std::process::ExitCode;

fn main() -> ExitCode {
    warplight_server::cli::main()
}
