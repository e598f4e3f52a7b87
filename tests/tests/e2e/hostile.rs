//! Clients and servers that mean no good, over real sockets: refused in words where they can hear, without harm to
//! others.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use warplight_client::net::{Command, Connection, Endpoint, News};
use warplight_client::session::SessionEnd;
use warplight_protocol::codec::{FrameShape, Limits, STRIP_HEADER_BYTES};
use warplight_protocol::frame::{FrameFormat, FrameId, Interfaces, Plan, VolumeRange};
use warplight_protocol::message::{
    Capabilities, ErrorCode, FrameBegin, FramePurpose, Hello, Message, PoseSample, Prediction, StripMessage, VERSION,
    Viewport, Welcome,
};
use warplight_protocol::trust::Fingerprint;
use warplight_protocol::wire::{Deframer, write_message};
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp, Token};
use warplight_server::net::{Identity, MAX_SESSIONS, listen, serve_until};
use warplight_server::scene::Scene;
use warplight_server::service::{Service, ServiceOptions};
use warplight_server::session::SampleBudget;

const PATIENCE: Duration = Duration::from_secs(20);

/// A server in this process that ends with its owner.
struct Server {
    address: SocketAddr,
    fingerprint: Option<Fingerprint>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    fn start(tls: bool, token: Token) -> Server {
        let samples = SampleBudget::Samples(1);
        let options = ServiceOptions { samples, threads: 1, still_threads: 1, ..ServiceOptions::default() };
        let mut service = Service::new(Scene::load("cornell").unwrap(), options).unwrap();
        service.session.token = token;
        let identity = tls.then(|| Identity::generate().unwrap());
        let fingerprint = identity.as_ref().map(Identity::fingerprint);
        let runtime = runtime();
        let listener = runtime.block_on(listen(([127, 0, 0, 1], 0).into())).unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let served = async move {
            let stopped = async { drop(stopped.await) };
            serve_until(listener, service, identity, stopped).await.unwrap();
        };
        let thread = std::thread::spawn(move || runtime.block_on(served));
        Server { address, fingerprint, stop: Some(stop), thread: Some(thread) }
    }

    fn endpoint(&self, token: Token) -> Endpoint {
        Endpoint { address: self.address.to_string(), fingerprint: self.fingerprint, token }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    fn stop(&mut self) {
        drop(self.stop.take());
        self.thread.take().unwrap().join().unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.thread.is_some() {
            self.stop();
        }
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn hello(side: u32) -> Hello {
    Hello {
        capabilities: Capabilities::ALL,
        software: "harness".to_owned(),
        camera: Camera::symmetric(1.0, ImageSize::new(side, side)),
        viewport: Viewport::Plane,
        frame_hz: 5.0,
        format: FrameFormat::default(),
        target_kbps: 0,
        prediction: Prediction::default(),
        token: Token::NONE,
        adapt: false,
    }
}

fn framed(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_message(message, &mut bytes);
    bytes
}

fn read(bytes: &[u8]) -> Vec<Message> {
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(bytes);
    std::iter::from_fn(|| deframer.next_message().ok().flatten()).collect()
}

/// Everything that a server says to whoever says `bytes`, until it closes.
fn answer(mut stream: TcpStream, bytes: &[u8]) -> Vec<u8> {
    stream.write_all(bytes).unwrap();
    let mut answer = Vec::new();
    // A connection that is reset has said what it had to say.
    let _ = stream.read_to_end(&mut answer);
    answer
}

/// The first message of a server to this hello, through TLS where it has some.
fn first_answer(endpoint: &Endpoint, hello: Hello) -> Message {
    runtime().block_on(async {
        let mut stream = endpoint.open().await.unwrap();
        stream.write_all(&framed(&Message::Hello(Hello { token: endpoint.token.clone(), ..hello }))).await.unwrap();
        stream.flush().await.unwrap();
        let mut heard = Vec::new();
        while read(&heard).is_empty() {
            assert!(stream.read_buf(&mut heard).await.unwrap() > 0, "closed without a word");
        }
        read(&heard).remove(0)
    })
}

fn token() -> Token {
    Token::new("correct-horse-battery").unwrap()
}

#[test]
fn only_who_knows_the_token_is_served() {
    let server = Server::start(true, token());
    assert!(matches!(first_answer(&server.endpoint(token()), hello(16)), Message::Welcome(_)));
    for wrong in [Token::NONE, Token::new("correct-horse-batterz").unwrap()] {
        let said = first_answer(&server.endpoint(wrong), hello(16));
        assert!(matches!(said, Message::Error { code: ErrorCode::Unauthorised, .. }), "{said:?}");
    }
    assert!(matches!(first_answer(&server.endpoint(token()), hello(16)), Message::Welcome(_)), "unharmed");
}

#[test]
fn a_client_gives_up_where_the_certificate_is_not_the_one() {
    let server = Server::start(true, Token::NONE);
    let endpoint = Endpoint { fingerprint: Some(Fingerprint([7; 32])), ..server.endpoint(token()) };
    let connection = Connection::start(endpoint, hello(16), Instant::now()).unwrap();
    let news = connection.wait_for_news(PATIENCE);
    let Some(News::Failed(SessionEnd::Untrusted(other))) = news else { panic!("{news:?}") };
    assert_eq!(Some(other.found), server.fingerprint, "it says what it found");
}

#[test]
fn neither_end_falls_back_to_a_link_without_tls() {
    let server = Server::start(true, Token::NONE);
    let said = answer(server.connect(), &framed(&Message::Hello(hello(16))));
    assert!(!read(&said).iter().any(|message| matches!(message, Message::Welcome(_))), "{said:?}");

    let plain = Server::start(false, Token::NONE);
    let endpoint = Endpoint { fingerprint: Some(Fingerprint([7; 32])), ..plain.endpoint(token()) };
    assert!(runtime().block_on(endpoint.open()).is_err());
    assert!(matches!(first_answer(&plain.endpoint(Token::NONE), hello(16)), Message::Welcome(_)), "unharmed");
}

#[test]
fn an_older_version_is_refused_by_number() {
    let server = Server::start(false, Token::NONE);
    let mut bytes = framed(&Message::Hello(hello(16)));
    bytes[9..11].copy_from_slice(&(VERSION - 1).to_le_bytes());
    let said = read(&answer(server.connect(), &bytes));
    let [Message::Error { code: ErrorCode::Version, text }] = &said[..] else { panic!("{said:?}") };
    assert!(text.contains(&VERSION.to_string()) && text.contains(&(VERSION - 1).to_string()), "{text}");
}

#[test]
fn what_was_recorded_opens_nothing() {
    // A hello said twice, without TLS.
    let plain = Server::start(false, Token::NONE);
    let hello_bytes = framed(&Message::Hello(hello(16)));
    let said = read(&answer(plain.connect(), &[&hello_bytes[..], &hello_bytes].concat()));
    assert!(matches!(&said.last(), Some(Message::Error { code: ErrorCode::Protocol, .. })), "{said:?}");

    // Everything that a client said through TLS, said again.
    let server = Server::start(true, token());
    let between = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = Endpoint { address: between.local_addr().unwrap().to_string(), ..server.endpoint(token()) };
    let mut up = server.connect();
    let recorder = std::thread::spawn(move || {
        let (mut client, _) = between.accept().unwrap();
        let (mut down, mut back) = (up.try_clone().unwrap(), client.try_clone().unwrap());
        std::thread::spawn(move || std::io::copy(&mut down, &mut back));
        let (mut recorded, mut buffer) = (Vec::new(), [0; 4096]);
        while let Ok(bytes @ 1..) = client.read(&mut buffer) {
            recorded.extend_from_slice(&buffer[..bytes]);
            up.write_all(&buffer[..bytes]).unwrap();
        }
        let _ = up.shutdown(std::net::Shutdown::Both);
        recorded
    });
    assert!(matches!(first_answer(&endpoint, hello(16)), Message::Welcome(_)));
    let recorded = recorder.join().unwrap();
    assert!(recorded.len() > 200 && !String::from_utf8_lossy(&recorded).contains("horse"), "and holds no token");
    let start = Instant::now();
    let said = answer(server.connect(), &recorded);
    assert!(said.len() < 2000 && start.elapsed() < PATIENCE, "a handshake at most, and then it is closed");
    assert!(matches!(first_answer(&server.endpoint(token()), hello(16)), Message::Welcome(_)), "unharmed");
}

/// Says a byte every 200 ms; what it hears and when it is closed.
fn dribble(mut stream: TcpStream, bytes: &[u8]) -> (Vec<u8>, Duration) {
    let start = Instant::now();
    let mut reader = stream.try_clone().unwrap();
    let heard = std::thread::spawn(move || {
        let mut heard = Vec::new();
        let _ = reader.read_to_end(&mut heard);
        (heard, start.elapsed())
    });
    for byte in bytes {
        if stream.write_all(&[*byte]).is_err() || heard.is_finished() {
            break;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    heard.join().unwrap()
}

#[test]
fn a_slow_loris_is_closed_and_takes_no_place() {
    let (plain, tls) = (Server::start(false, Token::NONE), Server::start(true, Token::NONE));
    let hello_bytes = framed(&Message::Hello(hello(16)));
    // The head of a TLS record of 512 bytes, and its first ones.
    let record: Vec<u8> = [22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3].into_iter().chain([0; 60]).collect();
    let lorises: Vec<_> = (0..MAX_SESSIONS + 2)
        .map(|number| {
            let is_tls = number % 2 == 1;
            let stream = if is_tls { tls.connect() } else { plain.connect() };
            let bytes = if is_tls { record.clone() } else { hello_bytes.clone() };
            std::thread::spawn(move || (is_tls, dribble(stream, &bytes)))
        })
        .collect();
    std::thread::sleep(Duration::from_secs(1));
    for server in [&plain, &tls] {
        assert!(matches!(first_answer(&server.endpoint(Token::NONE), hello(16)), Message::Welcome(_)), "unharmed");
    }
    for loris in lorises {
        let (is_tls, (heard, after)) = loris.join().unwrap();
        assert!(after > Duration::from_secs(4) && after < Duration::from_secs(9), "{after:?}");
        let is_told = String::from_utf8_lossy(&heard).contains("did not say hello within 5 s");
        assert!(is_tls || is_told, "{:?}", String::from_utf8_lossy(&heard));
    }
}

#[test]
fn a_bomb_of_zeros_is_refused_at_the_size_that_its_plane_has() {
    let shape = FrameShape {
        camera: Camera::symmetric(1.0, ImageSize::new(16, 16)),
        plan: Plan::diffuse(),
        interfaces: Interfaces::default(),
        format: FrameFormat::default(),
        volume: VolumeRange::default(),
        strip_rows: 16,
        exposure: 1.0,
    };
    // A gigabyte of zeros is 32 kB.
    let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..1024 {
        encoder.write_all(&zeros).unwrap();
    }
    let bomb = encoder.finish().unwrap();
    assert!(bomb.len() < 200_000);
    let mut strip = vec![0, 0, 16, 0, shape.planes().len() as u8];
    assert_eq!(strip.len(), STRIP_HEADER_BYTES);
    for (node, kind, bits) in shape.planes() {
        strip.extend_from_slice(&[node, kind as u8, 0, bits as u8, 0, 0]);
        strip.extend_from_slice(&(bomb.len() as u32).to_le_bytes());
        strip.extend_from_slice(&bomb);
    }
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let evil = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let welcome = Welcome {
            capabilities: Capabilities::ALL,
            software: "evil".to_owned(),
            scene: "bomb".to_owned(),
            effects: vec![],
            head: Pose::IDENTITY,
            exposure: 1.0,
        };
        let begin = FrameBegin {
            id: FrameId(1),
            purpose: FramePurpose::Live,
            pose_time: Timestamp::ZERO,
            horizon_micros: 0,
            scene_time: Timestamp::ZERO,
            render_pose: Pose::IDENTITY,
            shape,
        };
        let strip = StripMessage { frame: FrameId(1), bytes: strip };
        for message in [Message::Welcome(welcome), Message::FrameBegin(begin), Message::Strip(strip)] {
            stream.write_all(&framed(&message)).unwrap();
        }
        let mut said = Vec::new();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let _ = stream.read_to_end(&mut said);
        said
    });
    let connection = Connection::start(Endpoint::plain(address), hello(16), Instant::now()).unwrap();
    assert!(matches!(connection.wait_for_news(PATIENCE), Some(News::Open(_))));
    let news = connection.wait_for_news(PATIENCE);
    let Some(News::Lost { why, .. }) = news else { panic!("{news:?}") };
    connection.tell(Command::Close);
    assert!(why.contains("what is no message"), "{why}");
    let said = read(&evil.join().unwrap());
    assert!(said.iter().any(|message| matches!(message, Message::Error { .. })), "{said:?}");
}

/// A client of ours that counts frames until all together have so many, or it takes too long.
fn watch(endpoint: Endpoint, side: u32, all: Arc<AtomicUsize>, wanted: usize) -> std::thread::JoinHandle<usize> {
    std::thread::spawn(move || {
        let connection = Connection::start(endpoint, hello(side), Instant::now()).unwrap();
        let mut frames = 0;
        while all.load(Relaxed) < wanted && connection.now().micros < 90_000_000 {
            connection.tell(Command::Pose(PoseSample { time: connection.now(), pose: Pose::IDENTITY }));
            match connection.wait_for_news(Duration::from_millis(16)) {
                Some(News::Frame(frame)) => {
                    frames += 1;
                    all.fetch_add(1, Relaxed);
                    connection.tell(Command::Retire(frame));
                }
                Some(News::Lost { why, .. }) => panic!("{why}"),
                _ => {}
            }
        }
        connection.tell(Command::Close);
        frames
    })
}

/// Asks for frames and tells where its head is, and never reads; when it was closed.
fn never_reads(server: &Server, side: u32) -> std::thread::JoinHandle<Duration> {
    let mut stream = server.connect();
    std::thread::spawn(move || {
        let start = Instant::now();
        stream.write_all(&framed(&Message::Hello(hello(side)))).unwrap();
        loop {
            let time = Timestamp { micros: start.elapsed().as_micros() as u64 };
            let poses = framed(&Message::Poses(vec![PoseSample { time, pose: Pose::IDENTITY }]));
            if stream.write_all(&poses).is_err() || start.elapsed() > PATIENCE {
                return start.elapsed();
            }
            std::thread::sleep(Duration::from_millis(16));
        }
    })
}

fn eight_beside_a_ninth(side: u32, frames_each: usize) {
    let server = Server::start(false, Token::NONE);
    let ninth = never_reads(&server, side);
    let all = Arc::new(AtomicUsize::new(0));
    let one = || watch(server.endpoint(Token::NONE), side, all.clone(), 8 * frames_each);
    let start = Instant::now();
    let eight: Vec<_> = (0..8).map(|_| one()).collect();
    let frames: Vec<usize> = eight.into_iter().map(|client| client.join().unwrap()).collect();
    let took = start.elapsed();
    let closed = ninth.join().unwrap();
    eprintln!("{side}x{side}: frames {frames:?} in {took:.1?}, the ninth closed after {closed:.1?}");
    assert!(closed < Duration::from_secs(15), "{closed:?}");
    // One frame may be under way to each when it ends.
    let mean = frames.iter().sum::<usize>() as f64 / 8.0;
    let is_fair = |&count: &usize| (count as f64 - mean).abs() <= (0.2 * mean).max(1.5);
    assert!(mean >= frames_each as f64 && frames.iter().all(is_fair), "{frames:?}");
}

#[test]
fn eight_small_clients_are_served_alike_and_a_ninth_that_never_reads_is_closed() {
    eight_beside_a_ninth(32, 8);
}

/// The long form: `cargo test --release -p warplight-tests --test e2e -- --ignored --nocapture eight_clients`.
#[test]
#[ignore = "a minute"]
fn eight_clients_are_served_alike_and_a_ninth_that_never_reads_is_closed() {
    eight_beside_a_ninth(256, 50);
}

#[test]
fn one_client_too_many_is_told_so_and_one_that_leaves_makes_room() {
    let mut server = Server::start(false, Token::NONE);
    let mut guests: Vec<TcpStream> = (0..MAX_SESSIONS)
        .map(|_| {
            let mut stream = server.connect();
            stream.write_all(&framed(&Message::Hello(hello(16)))).unwrap();
            let mut welcome = [0; 5];
            stream.read_exact(&mut welcome).unwrap();
            assert_eq!(welcome[4], 2, "a welcome");
            stream
        })
        .collect();
    let said = first_answer(&server.endpoint(Token::NONE), hello(16));
    let Message::Error { code: ErrorCode::Busy, text } = &said else { panic!("{said:?}") };
    assert!(text.contains(&MAX_SESSIONS.to_string()), "{text}");
    guests.pop().unwrap().write_all(&framed(&Message::Bye)).unwrap();
    let deadline = Instant::now() + PATIENCE;
    while !matches!(first_answer(&server.endpoint(Token::NONE), hello(16)), Message::Welcome(_)) {
        assert!(Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(50));
    }
    // And a server that stops says goodbye to all that are still there.
    let stopping = Instant::now();
    server.stop();
    assert!(stopping.elapsed() < Duration::from_secs(5));
    let mut last = Vec::new();
    let _ = guests.pop().unwrap().read_to_end(&mut last);
    assert!(last.ends_with(&framed(&Message::Bye)) || last.windows(4).any(|window| window == b"said"), "{last:?}");
}
