//! The program `warplight-client`.

use std::process::ExitCode;

fn main() -> ExitCode {
    warplight_client::cli::main()
}
