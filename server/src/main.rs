//! The server's command; everything is in the library.

fn main() -> std::process::ExitCode {
    warplight_server::cli::main()
}
