//! The session over TCP and real time, on a thread of its own: the only file of the client with sockets, and
//! beside the display loop and the benchmarks the only one with a clock.
//!
//! Connecting and reconnecting are one path: try, back off, try again. Poses that arrive here while there is no
//! session are dropped; frames go out decoded, and of those not yet taken the display keeps the last.

use crate::assemble::{Assembler, ReadyFrame};
use crate::session::{ClientSession, Event, SessionEnd};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc as received};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use warplight_protocol::Timestamp;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::message::{FramePurpose, Hello, PoseSample, Statistics, StillRequest, Welcome};

/// First wait before another try, doubled with every failure.
const FIRST_BACKOFF: Duration = Duration::from_millis(50);
/// Longest wait: a link that is back is noticed within this.
const LONGEST_BACKOFF: Duration = Duration::from_millis(500);
/// A connection attempt is given up after this.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// The goodbye has this long to leave.
const FAREWELL: Duration = Duration::from_millis(200);

/// What the display asks of the network thread.
#[derive(Debug)]
pub enum Command {
    /// Here is the head.
    Pose(PoseSample),
    /// A converged picture, please.
    Still(StillRequest),
    /// This frame will not be shown again.
    Retire(Arc<ReadyFrame>),
    /// Goodbye.
    Close,
}

/// What the network thread tells the display.
#[derive(Debug)]
pub enum News {
    /// A session is open; the first or, after a loss, another.
    Open(Welcome),
    /// A frame or still is ready.
    Frame(Arc<ReadyFrame>),
    /// The server's totals.
    Statistics(Statistics),
    /// The session is lost and will be opened again.
    Lost(String),
    /// It is over.
    Over,
    /// It cannot be opened.
    Failed(SessionEnd),
}

/// What went over the link so far, in all sessions together.
#[derive(Debug, Default)]
pub struct Traffic {
    down_bytes: AtomicU64,
    up_bytes: AtomicU64,
}

impl Traffic {
    /// Bytes from the server.
    pub fn down_bytes(&self) -> u64 {
        self.down_bytes.load(Relaxed)
    }

    /// Bytes to the server.
    pub fn up_bytes(&self) -> u64 {
        self.up_bytes.load(Relaxed)
    }
}

/// The network thread's ends.
#[derive(Debug)]
pub struct Connection {
    commands: mpsc::UnboundedSender<Command>,
    news: received::Receiver<News>,
    traffic: Arc<Traffic>,
    epoch: Instant,
}

impl Connection {
    /// Starts connecting to `address` (host and port). `epoch` is the zero of the client's clock.
    pub fn start(address: String, hello: Hello, epoch: Instant) -> io::Result<Connection> {
        let (commands, command_receiver) = mpsc::unbounded_channel();
        let (news_sender, news) = received::channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let traffic = Arc::new(Traffic::default());
        let assembler = Assembler::default();
        let network = Network {
            address,
            hello,
            epoch,
            news: news_sender,
            assembler,
            traffic: traffic.clone(),
            last_read: Timestamp::ZERO,
        };
        std::thread::Builder::new()
            .name("network".to_owned())
            .spawn(move || runtime.block_on(network.run(command_receiver)))?;
        Ok(Connection { commands, news, traffic, epoch })
    }

    /// Asks something of the network thread; once it is over, nothing happens.
    pub fn tell(&self, command: Command) {
        let _ = self.commands.send(command);
    }

    /// News, if there is some already.
    pub fn news(&self) -> Option<News> {
        self.news.try_recv().ok()
    }

    /// News, waiting for it at most so long.
    pub fn wait_for_news(&self, at_most: Duration) -> Option<News> {
        self.news.recv_timeout(at_most).ok()
    }

    /// What went over the link so far.
    pub fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    /// The client's clock.
    pub fn now(&self) -> Timestamp {
        timestamp(self.epoch, Instant::now())
    }

    /// Waits until the client's clock shows `time`.
    pub fn sleep_until(&self, time: Timestamp) {
        let now = self.now();
        if time > now {
            std::thread::sleep(time.since(now));
        }
    }
}

fn timestamp(epoch: Instant, instant: Instant) -> Timestamp {
    Timestamp { micros: instant.saturating_duration_since(epoch).as_micros() as u64 }
}

struct Network {
    address: String,
    hello: Hello,
    epoch: Instant,
    news: received::Sender<News>,
    assembler: Assembler,
    traffic: Arc<Traffic>,
    /// When the socket was read last: what it gave is decoded after that.
    last_read: Timestamp,
}

/// How a session ended.
enum Ending {
    Closed,
    Session(SessionEnd),
    Link(io::Error),
}

impl Network {
    async fn run(mut self, mut commands: mpsc::UnboundedReceiver<Command>) {
        let mut backoff = FIRST_BACKOFF;
        loop {
            let connecting = tokio::time::timeout(CONNECT_TIMEOUT, TcpStream::connect(&self.address));
            let ending = match connecting.await.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())) {
                Ok(socket) => {
                    let mut was_open = false;
                    let ending = self.converse(socket, &mut commands, &mut was_open).await;
                    if was_open {
                        backoff = FIRST_BACKOFF;
                    }
                    ending
                }
                Err(error) => Ending::Link(error),
            };
            let why = match ending {
                Ending::Closed => break,
                Ending::Session(end) if end.is_final() => {
                    let _ = self.news.send(News::Failed(end));
                    return;
                }
                Ending::Session(end) => end.to_string(),
                Ending::Link(error) => format!("{}: {error}", self.address),
            };
            if self.news.send(News::Lost(why)).is_err() || wait(backoff, &mut commands).await {
                break;
            }
            backoff = (backoff * 2).min(LONGEST_BACKOFF);
        }
        let _ = self.news.send(News::Over);
    }

    fn now(&self) -> Timestamp {
        timestamp(self.epoch, Instant::now())
    }

    async fn converse(
        &mut self,
        mut socket: TcpStream,
        commands: &mut mpsc::UnboundedReceiver<Command>,
        was_open: &mut bool,
    ) -> Ending {
        if let Err(error) = socket.set_nodelay(true) {
            return Ending::Link(error);
        }
        let mut session = ClientSession::new(self.hello.clone(), Limits::default(), self.now());
        let (mut reader, mut writer) = socket.split();
        let mut received = vec![0; 256 << 10];
        let mut outgoing = Vec::new();
        let mut written = 0;
        loop {
            while let Some(event) = session.poll_event() {
                *was_open = true;
                if let Err(error) = self.on_event(event, &mut session) {
                    session.refuse(error);
                }
            }
            if written == outgoing.len() {
                outgoing.clear();
                written = 0;
                session.poll_transmit(self.now(), &mut outgoing);
            }
            if let Some(end) = session.end().cloned() {
                while session.poll_transmit(self.now(), &mut outgoing) {}
                // Whether it is heard makes no difference any more.
                let _ = tokio::time::timeout(FAREWELL, writer.write_all(&outgoing[written..])).await;
                return if end == SessionEnd::Closed { Ending::Closed } else { Ending::Session(end) };
            }
            let wake = self.epoch + Duration::from_micros(session.next_timeout().micros);
            tokio::select! {
                read = reader.read(&mut received) => match read {
                    Ok(0) => return Ending::Link(io::ErrorKind::UnexpectedEof.into()),
                    Ok(bytes) => {
                        self.traffic.down_bytes.fetch_add(bytes as u64, Relaxed);
                        self.last_read = self.now();
                        session.on_bytes(self.last_read, &received[..bytes]);
                    }
                    Err(error) => return Ending::Link(error),
                },
                sent = writer.write(&outgoing[written..]), if written < outgoing.len() => match sent {
                    Ok(bytes) => {
                        self.traffic.up_bytes.fetch_add(bytes as u64, Relaxed);
                        written += bytes;
                    }
                    Err(error) => return Ending::Link(error),
                },
                command = commands.recv() => match command {
                    Some(Command::Pose(sample)) => session.push_pose(sample),
                    Some(Command::Still(request)) => session.request_still(request),
                    Some(Command::Retire(frame)) => self.assembler.retire(frame),
                    Some(Command::Close) | None => session.close(),
                },
                () = tokio::time::sleep_until(wake.into()) => session.on_timeout(self.now()),
            }
        }
    }

    fn on_event(&mut self, event: Event, session: &mut ClientSession) -> Result<(), DecodeError> {
        let news = match event {
            Event::Welcome(welcome) => {
                self.assembler.new_session();
                News::Open(welcome)
            }
            Event::FrameBegin(begin) => {
                self.assembler.begin(begin);
                return Ok(());
            }
            Event::Strip(strip) => {
                let start = Instant::now();
                return self.assembler.strip(&strip, || start.elapsed());
            }
            Event::Picture(picture) => {
                let start = Instant::now();
                return self.assembler.picture(picture, || start.elapsed());
            }
            Event::FrameEnd(end) => {
                let now = self.now();
                let frame = self.assembler.end(end, self.last_read, now)?;
                // A still answers no pose, so there is no delay to tell.
                if frame.begin.purpose == FramePurpose::Live {
                    session.acknowledge(frame.begin.id, now.since(frame.begin.pose_time));
                }
                News::Frame(frame)
            }
            Event::Statistics(statistics) => News::Statistics(statistics),
            Event::RoundTrip(_) => return Ok(()),
        };
        // Nobody listens any more: the command to close is on its way.
        let _ = self.news.send(news);
        Ok(())
    }
}

/// Waits before the next try; true where the display says goodbye meanwhile.
async fn wait(backoff: Duration, commands: &mut mpsc::UnboundedReceiver<Command>) -> bool {
    let sleep = tokio::time::sleep(backoff);
    tokio::pin!(sleep);
    loop {
        tokio::select! {
            () = &mut sleep => return false,
            command = commands.recv() => if matches!(command, None | Some(Command::Close)) {
                return true;
            },
        }
    }
}
