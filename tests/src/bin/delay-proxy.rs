//! A link with delay where the kernel has none to give: TCP in, TCP out, and between them each byte waits.
//!
//! `delay-proxy LISTEN CONNECT DELAY_MS [JITTER_MS] [SEED]`: what is read is written DELAY_MS later, and up to JITTER_MS
//! more or less, uniformly and seeded; like TCP it never reorders. Each way of a connection has a thread that reads and one
//! that writes; between them lie at most [`UNDER_WAY`] pieces, so that a slow receiver is felt by the sender. For
//! `tests/two_hosts.sh`, where there is no tc netem.

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes read at once at most.
const PIECE_BYTES: usize = 16 << 10;
/// Pieces that wait: 2 MiB, 100 ms of 160 Mbit/s.
const UNDER_WAY: usize = 128;

#[derive(Clone, Copy)]
struct Delay {
    mean: Duration,
    jitter: Duration,
}

impl Delay {
    fn draw(&self, random: &mut Pcg32) -> Duration {
        let uniform = f64::from(random.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0;
        Duration::from_secs_f64((self.mean.as_secs_f64() + uniform * self.jitter.as_secs_f64()).max(0.0))
    }
}

fn read(mut from: TcpStream, pieces: &SyncSender<(Instant, Vec<u8>)>, delay: Delay, mut random: Pcg32) {
    let mut buffer = vec![0; PIECE_BYTES];
    let mut last = Instant::now();
    while let Ok(bytes @ 1..) = from.read(&mut buffer) {
        // Never before what was read before it.
        last = last.max(Instant::now() + delay.draw(&mut random));
        if pieces.send((last, buffer[..bytes].to_vec())).is_err() {
            break;
        }
    }
}

fn write(mut to: TcpStream, pieces: &Receiver<(Instant, Vec<u8>)>) {
    for (at, bytes) in pieces {
        thread::sleep(at.saturating_duration_since(Instant::now()));
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
    // The other end is gone, or cannot be told: so is this one.
    let _ = to.shutdown(Shutdown::Both);
}

fn one_way(from: &TcpStream, to: &TcpStream, delay: Delay, random: Pcg32) -> std::io::Result<()> {
    let (sender, receiver) = sync_channel(UNDER_WAY);
    let (from, to) = (from.try_clone()?, to.try_clone()?);
    thread::spawn(move || read(from, &sender, delay, random));
    thread::spawn(move || write(to, &receiver));
    Ok(())
}

fn join(client: &TcpStream, address: &str, delay: Delay, seed: u64) -> std::io::Result<()> {
    let server = TcpStream::connect(address)?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    one_way(client, &server, delay, Pcg32::new(seed, 1))?;
    one_way(&server, client, delay, Pcg32::new(seed, 2))
}

fn millis(text: &str) -> Option<Duration> {
    text.parse()
        .ok()
        .filter(|value| (0.0..=10_000.0).contains(value))
        .map(|value: f64| Duration::from_secs_f64(value * 1e-3))
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let parsed = match &arguments[..] {
        [listen, connect, delay, rest @ ..] if rest.len() <= 2 => {
            let jitter = rest.first().map_or(Some(Duration::ZERO), |text| millis(text));
            let seed = rest.get(1).map_or(Ok(1), |text| text.parse::<u64>()).ok();
            millis(delay)
                .zip(jitter)
                .zip(seed)
                .map(|((mean, jitter), seed)| (listen, connect, Delay { mean, jitter }, seed))
        }
        _ => None,
    };
    let Some((listen, connect, delay, seed)) = parsed else {
        eprintln!("error: expected LISTEN CONNECT DELAY_MS [JITTER_MS] [SEED], times from 0 to 10000");
        return ExitCode::from(2);
    };
    let listener = match TcpListener::bind(listen) {
        Ok(listener) => listener,
        Err(error) => {
            eprintln!("error: {listen}: {error}");
            return ExitCode::from(2);
        }
    };
    match listener.local_addr() {
        Ok(address) => println!("{address}"),
        Err(error) => eprintln!("error: {listen}: {error}"),
    }
    for (number, client) in (0_u64..).zip(listener.incoming().flatten()) {
        // A server that is not there: the client is let go, and tries again.
        if let Err(error) = join(&client, connect, delay, seed.wrapping_add(number)) {
            eprintln!("{connect}: {error}");
        }
    }
    ExitCode::SUCCESS
}
