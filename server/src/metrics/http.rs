//! `GET /metrics` over plain HTTP/1.1: one request per connection, one connection at a time, on a thread of its own.
//!
//! Nothing is read but the first line, and no more than `MAX_REQUEST_BYTES`; who is slow is left after some
//! `PATIENCE`. There is no encryption and nobody is asked who they are, so it is for loopback, or a person says otherwise.

use super::Metrics;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::Duration;

/// A request that says what it wants later than this is none of ours.
const MAX_REQUEST_BYTES: usize = 4096;
/// A read or write that takes longer ends the connection.
const PATIENCE: Duration = Duration::from_millis(500);
/// So do this many reads without an end of the request.
const MAX_READS: usize = 8;

/// Answers at `address` until the process ends; tells where, for port 0.
///
/// # Errors
/// What the operating system says of the address or the thread.
pub fn serve(address: SocketAddr, metrics: Arc<Metrics>) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind(address)?;
    let address = listener.local_addr()?;
    std::thread::Builder::new().name("metrics".to_owned()).spawn(move || {
        for stream in listener.incoming() {
            if let Err(error) = stream.and_then(|stream| answer(stream, &metrics)) {
                tracing::debug!("a request for metrics failed: {error}");
            }
        }
    })?;
    Ok(address)
}

fn answer(mut stream: TcpStream, metrics: &Metrics) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut request = Vec::new();
    let mut part = [0; MAX_REQUEST_BYTES];
    for _ in 0..MAX_READS {
        let bytes = stream.read(&mut part)?;
        request.extend_from_slice(&part[..bytes]);
        let is_whole = request.windows(4).any(|end| end == b"\r\n\r\n");
        if bytes == 0 || is_whole || request.len() >= MAX_REQUEST_BYTES {
            break;
        }
    }
    let (status, body) = response(&request, metrics);
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
}

/// Status and body for a request.
fn response(request: &[u8], metrics: &Metrics) -> (&'static str, String) {
    let line = request.split(|&byte| byte == b'\r').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line);
    let mut words = line.split(' ');
    let (method, target, version) = (words.next(), words.next(), words.next());
    if !version.is_some_and(|version| version.starts_with("HTTP/1.")) {
        return ("400 Bad Request", "expected GET /metrics over HTTP/1.1\n".to_owned());
    }
    match (method, target.map(|target| target.split('?').next())) {
        (Some("GET"), Some(Some("/metrics"))) => ("200 OK", metrics.text()),
        (Some("GET"), _) => ("404 Not Found", "expected /metrics\n".to_owned()),
        _ => ("405 Method Not Allowed", "expected GET\n".to_owned()),
    }
}
