//! The programs as a person runs them: exit status, one clear line for bad input, files whole or not at all, and
//! a server that goes away and comes back.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn program(name: &str) -> &'static str {
    match name {
        "warplight-server" => env!("CARGO_BIN_EXE_server-under-test"),
        _ => env!("CARGO_BIN_EXE_client-under-test"),
    }
}

fn run(name: &str, arguments: &[&str]) -> Output {
    Command::new(program(name)).args(arguments).stdin(Stdio::null()).output().unwrap()
}

/// Exit status 2 and one line on stderr that holds all of `words`.
fn refused(name: &str, arguments: &[&str], words: &[&str]) {
    let output = run(name, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments:?}: '{word}' is missing in: {said}");
    }
    assert_eq!(said.trim_end().lines().count(), 1, "{arguments:?}: {said}");
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn bad_scenes_get_one_clear_line() {
    let folder = tempfile::tempdir().unwrap();
    let unknown_key = write(folder.path(), "a.toml", "[head]\nposition = [0.0, 1.6, 0.0]\ncolour = 3\n");
    let broken = write(folder.path(), "b.glb", "glTF\x02\x00\x00");
    let picture = folder.path().join("x.png");
    let picture = picture.to_str().unwrap();
    refused("warplight-server", &["render", "no-such-scene", "-o", picture], &["no-such-scene", "gallery"]);
    refused("warplight-server", &["render", "/no/such/file.glb", "-o", picture], &["/no/such/file.glb"]);
    refused("warplight-server", &["render", &unknown_key, "-o", picture], &["a.toml", "colour"]);
    refused("warplight-server", &["inspect", &broken], &["b.glb"]);
    refused("warplight-client", &["replay", "--scene", &unknown_key], &["a.toml", "colour"]);
    assert!(!Path::new(picture).exists(), "nothing is left behind");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "no temporary file either");
}

#[test]
fn bad_traces_get_one_clear_line() {
    let folder = tempfile::tempdir().unwrap();
    let nan = write(folder.path(), "nan.tum", "0 0 0 0 0 0 0 1\n0.1 0 NaN 0 0 0 0 1\n");
    let back = write(folder.path(), "back.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1\n");
    refused("warplight-client", &["replay", "--trace", &nan], &["nan.tum", "2", "ty"]);
    refused("warplight-client", &["trace", "info", &back], &["back.tum", "3"]);
    refused("warplight-client", &["trace", "info", "/no/such.tum"], &["/no/such.tum"]);
}

#[test]
fn bad_arguments_exit_with_two() {
    for arguments in [
        &["replay", "--size", "0x3"][..],
        &["replay", "--mode", "magic"],
        &["replay", "--frame-hz", "NaN"],
        &["replay", "--latency-ms", "20"],
        &["replay", "--clock", "virtual", "--connect", "127.0.0.1:1"],
        &["nonsense"],
    ] {
        let output = run("warplight-client", arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    refused("warplight-server", &["serve", "--listen", "0.0.0.0:0"], &["--listen 0.0.0.0:0", "--insecure"]);
}

#[test]
fn a_port_in_use_is_said_at_once() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    refused("warplight-server", &["serve", "--scene", "cornell", "--listen", &address], &[&address, "in use"]);
}

#[test]
fn a_server_that_is_not_there_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    drop(taken);
    let start = Instant::now();
    let output = run("warplight-client", &["replay", "--connect", &address]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains(&address));
    assert!(start.elapsed() < Duration::from_secs(30));
}

/// A server process that ends with its owner.
struct Server(Child);

impl Server {
    fn start(address: &str) -> Server {
        let arguments = ["serve", "--scene", "cornell", "--listen", address, "--spp", "1", "--threads", "1"];
        Server(Command::new(program("warplight-server")).args(arguments).stdin(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An address that was free a moment ago.
fn free_address() -> String {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

fn replay(address: &str, seconds: &str, out: &Path) -> Command {
    let mut command = Command::new(program("warplight-client"));
    command
        .args([
            "replay",
            "--connect",
            address,
            "--size",
            "64x64",
            "--quality-spp",
            "1",
            "--duration-s",
            seconds,
            "--out",
        ])
        .arg(out)
        .stdin(Stdio::null());
    command
}

fn report_in(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap()
}

#[test]
fn two_processes_replay_and_report() {
    let address = free_address();
    let _server = Server::start(&address);
    let out = tempfile::tempdir().unwrap();
    let output = replay(&address, "2", out.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = report_in(out.path());
    assert_eq!(report["schema"], 1);
    assert_eq!(report["scene"], "cornell");
    assert!(report["link"]["frames_shown"].as_u64().unwrap() > 5);
    let page = std::fs::read_to_string(out.path().join("index.html")).unwrap();
    for outside in ["http://", "https://", "src=\"//", "@import"] {
        // The namespace of SVG is a name, not a reference.
        assert!(!page.replace("http://www.w3.org/2000/svg", "").contains(outside), "{outside}");
    }
}

#[test]
fn a_client_comes_back_to_a_server_that_was_killed() {
    let address = free_address();
    let server = Server::start(&address);
    let out = tempfile::tempdir().unwrap();
    let client = replay(&address, "8", out.path()).stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(3));
    drop(server);
    std::thread::sleep(Duration::from_secs(1));
    let _server = Server::start(&address);
    let output = client.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = report_in(out.path());
    assert_eq!(report["link"]["reconnects"], 1);
    // Frames from after the restart: the last second shows nothing older than a second.
    let ages = report["series"]["display"]["frame_age_ms"].as_array().unwrap();
    let last = &ages[ages.len() - 30..];
    assert!(last.iter().all(|age| age.as_f64().unwrap() < 1000.0), "{last:?}");
}

#[test]
fn a_peer_that_speaks_nonsense_is_told_so_and_others_go_on() {
    use std::io::{Read, Write};
    let address = free_address();
    let _server = Server::start(&address);
    let connect = || {
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            match std::net::TcpStream::connect(&address) {
                Ok(stream) => return stream,
                Err(error) if Instant::now() > deadline => panic!("{error}"),
                Err(_) => std::thread::sleep(Duration::from_millis(20)),
            }
        }
    };
    // A hello of version 9, and bytes that are no message.
    for (bytes, expected) in
        [(&b"\x07\0\0\0\x01WARP\x09\0"[..], "version 9"), (&[0xff; 64][..], "unsupported kind of message")]
    {
        let mut stream = connect();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        stream.write_all(bytes).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        assert!(String::from_utf8_lossy(&answer).contains(expected), "{:?}", String::from_utf8_lossy(&answer));
    }
    // One that is silent is let go after two seconds.
    let mut silent = connect();
    silent.set_read_timeout(Some(Duration::from_secs(6))).unwrap();
    let mut answer = Vec::new();
    silent.read_to_end(&mut answer).unwrap();
    assert!(String::from_utf8_lossy(&answer).contains("said nothing for 2 s"));

    let out = tempfile::tempdir().unwrap();
    assert!(replay(&address, "1", out.path()).output().unwrap().status.success());
}

#[test]
fn a_probe_says_what_the_link_and_the_server_are_good_for() {
    let address = free_address();
    let refused = run("warplight-client", &["probe", &address, "--seconds", "1"]);
    assert_eq!(refused.status.code(), Some(1), "nobody listens");
    assert!(String::from_utf8_lossy(&refused.stderr).contains(&address));
    let _server = Server::start(&address);
    let probe = |more: &[&str]| {
        let arguments = [&["probe", &address, "--size", "32x32", "--seconds", "3"], more].concat();
        let output = run("warplight-client", &arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let table = probe(&["--frame-hz", "2"]);
    for word in ["round trip", "jitter", "throughput", "fits"] {
        assert!(table.contains(word), "{table}");
    }
    let found: serde_json::Value = serde_json::from_str(&probe(&["--frame-hz", "1000", "--json"])).unwrap();
    assert!(found["round_trip_ms"]["count"].as_u64().unwrap() > 5, "{found}");
    assert!(found["frame_hz"].as_f64().unwrap() > 0.5, "{found}");
    assert_eq!(found["fits"], false, "poses come at 60 Hz, so 1000 frames per second cannot: {found}");
}

#[test]
fn beyond_loopback_takes_tls_and_a_token_or_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let token = write(folder.path(), "token", "correct-horse-battery\n");
    let short = write(folder.path(), "short", "horse\n");
    let serve = ["serve", "--listen", "0.0.0.0:0"];
    let with = |more: &[&'static str]| [&serve[..], more].concat();
    refused("warplight-server", &with(&[]), &["nothing is encrypted", "--tls and --token-file", "--insecure"]);
    refused("warplight-server", &with(&["--tls"]), &["anyone may connect", "--token-file"]);
    refused("warplight-server", &[&serve[..], &["--token-file", &token]].concat(), &["nothing is encrypted", "--tls"]);
    refused("warplight-server", &[&serve[..], &["--tls", "--token-file", &short]].concat(), &["short", "16 to 256"]);
    let connect = ["replay", "--connect", "127.0.0.1:1", "--token-file"];
    refused("warplight-client", &[&connect[..], &[&token]].concat(), &["unencrypted", "--fingerprint", "--insecure"]);
}

/// A server with TLS and a token beyond loopback, a client that knows both and one that knows one: and no log knows the
/// token.
#[cfg(unix)]
#[test]
fn two_processes_trust_each_other_and_nobody_tells_why() {
    use std::io::{BufRead, BufReader, Read};
    let folder = tempfile::tempdir().unwrap();
    let token = write(folder.path(), "token", "correct-horse-battery\n");
    let wrong = write(folder.path(), "wrong", "incorrect-horse-battery\n");
    let address = free_address().replace("127.0.0.1", "0.0.0.0");
    let kept = [folder.path().join("cert.pem"), folder.path().join("key.pem")];
    let mut server = Command::new(program("warplight-server"))
        .args(["serve", "--scene", "cornell", "--spp", "1", "--threads", "1", "--tls", "--listen", &address])
        .args(["--token-file", &token, "--certificate", kept[0].to_str().unwrap(), "--key", kept[1].to_str().unwrap()])
        .env("RUST_LOG", "trace")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = server.stderr.take().unwrap();
    let log = std::thread::spawn(move || {
        let mut log = String::new();
        stderr.read_to_string(&mut log).map(|_| log).unwrap()
    });
    let mut fingerprint = String::new();
    BufReader::new(server.stdout.take().unwrap()).read_line(&mut fingerprint).unwrap();
    let address = address.replace("0.0.0.0", "127.0.0.1");
    let client = |token: &str| {
        let out = tempfile::tempdir().unwrap();
        replay(&address, "1", out.path())
            .args(["--fingerprint", fingerprint.trim(), "--token-file", token])
            .env("RUST_LOG", "trace")
            .output()
            .unwrap()
    };
    let refused = client(&wrong);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(1) && said.contains("the token is not this server's"), "{said}");
    let served = client(&token);
    assert!(served.status.success(), "{}", String::from_utf8_lossy(&served.stderr));
    let id = server.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    assert_eq!(server.wait().unwrap().code(), Some(0), "a signal is how a server is stopped");
    let log = log.join().unwrap();
    assert_eq!(log.matches("refused: the token is not").count(), 1, "{log}");
    for text in [&log, &said, &String::from_utf8_lossy(&served.stderr).into_owned()] {
        assert!(!text.contains("horse"), "{text}");
    }
}
