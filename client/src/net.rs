//! The session over TCP and real time, on a thread of its own: the only file of the client with sockets, and
//! beside the display loop and the benchmarks the only one with a clock.
//!
//! Connecting and reconnecting are one path: try, back off, try again; a link that says nothing is tried again every
//! 250 ms, so that it is found within that once it is back. Poses that arrive here while there is no
//! session are dropped; frames go out decoded, and of those not yet taken the display keeps the last.

mod endpoint;

pub use endpoint::{Endpoint, OtherCertificate, Stream};

use crate::assemble::{Assembler, ReadyFrame};
use crate::session::{Backoff, ClientSession, Event, SessionEnd};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc as received};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::timeout;
use warplight_protocol::Timestamp;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::message::{FramePurpose, Hello, PoseSample, Statistics, StillRequest, Welcome};

/// A connection attempt is given up after this.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// While one is under way another is made after this: what is sent into a link that is down is lost, and TCP sends it
/// again after 1 s and longer (RFC 6298), when the link may have been back for as long. What is slower than this to
/// connect still does; the first attempt that is answered is the one.
const NEXT_ATTEMPT: Duration = Duration::from_millis(250);
/// The goodbye has this long to leave.
const FAREWELL: Duration = Duration::from_millis(200);

/// What the display asks of the network thread.
#[derive(Debug)]
pub enum Command {
    /// Here is the head.
    Pose(PoseSample),
    /// A converged picture, please.
    Still(StillRequest),
    /// How long is the way there and back?
    Ping,
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
    /// A ping came back after this long.
    RoundTrip(Duration),
    /// The session is lost and will be opened again.
    Lost {
        /// How it ended.
        why: String,
        /// A live frame had begun to arrive.
        frame_lost: bool,
    },
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
    /// Starts connecting. `epoch` is the zero of the client's clock.
    pub fn start(endpoint: Endpoint, hello: Hello, epoch: Instant) -> io::Result<Connection> {
        let (commands, command_receiver) = mpsc::unbounded_channel();
        let (news_sender, news) = received::channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let traffic = Arc::new(Traffic::default());
        let assembler = Assembler::default();
        let network = Network {
            hello: Hello { token: endpoint.token.clone(), ..hello },
            endpoint,
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
    endpoint: Endpoint,
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
        let mut backoff = Backoff::default();
        loop {
            let Some(connected) = unless_closed(connect(&self.endpoint), &mut commands).await else { break };
            let mut was_waiting = false;
            let ending = match connected {
                Ok(stream) => {
                    let mut was_open = false;
                    let ending = self.converse(stream, &mut commands, &mut was_open).await;
                    if was_open {
                        backoff.reset();
                    }
                    ending
                }
                Err(error) => {
                    was_waiting = error.kind() == io::ErrorKind::TimedOut;
                    Ending::Link(error)
                }
            };
            let why = match ending {
                Ending::Closed => break,
                Ending::Session(end) if end.is_final() => {
                    let _ = self.news.send(News::Failed(end));
                    return;
                }
                Ending::Session(end) => end.to_string(),
                Ending::Link(error) => match endpoint::other_certificate(&error) {
                    Some(other) => {
                        let _ = self.news.send(News::Failed(SessionEnd::Untrusted(other)));
                        return;
                    }
                    None => format!("{}: {error}", self.endpoint.address),
                },
            };
            if self.news.send(News::Lost { why, frame_lost: self.assembler.abandon() }).is_err() {
                break;
            }
            // Nobody refused: the time that it took was the wait.
            let pause = if was_waiting { Duration::ZERO } else { backoff.after_failure() };
            if unless_closed(tokio::time::sleep(pause), &mut commands).await.is_none() {
                break;
            }
        }
        let _ = self.news.send(News::Over);
    }

    fn now(&self) -> Timestamp {
        timestamp(self.epoch, Instant::now())
    }

    async fn converse(
        &mut self,
        stream: Box<dyn Stream>,
        commands: &mut mpsc::UnboundedReceiver<Command>,
        was_open: &mut bool,
    ) -> Ending {
        let mut session = ClientSession::new(self.hello.clone(), Limits::default(), self.now());
        let (mut reader, mut writer) = tokio::io::split(stream);
        let mut received = vec![0; 256 << 10];
        let mut outgoing = Vec::new();
        let mut written = 0;
        // What TLS still holds.
        let mut is_flushed = true;
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
                let farewell = async {
                    writer.write_all(&outgoing[written..]).await?;
                    writer.shutdown().await
                };
                let _ = timeout(FAREWELL, farewell).await;
                return if end == SessionEnd::Closed { Ending::Closed } else { Ending::Session(end) };
            }
            let is_waiting = written < outgoing.len() || !is_flushed;
            let mut wake = self.epoch + Duration::from_micros(session.next_timeout().micros);
            if is_waiting {
                // A ping is due that cannot leave.
                wake = wake.max(Instant::now() + Backoff::FIRST);
            }
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
                sent = push(&mut writer, &outgoing[written..]), if is_waiting => match sent {
                    Ok(bytes) => {
                        self.traffic.up_bytes.fetch_add(bytes as u64, Relaxed);
                        written += bytes;
                        is_flushed = bytes == 0;
                    }
                    Err(error) => return Ending::Link(error),
                },
                command = commands.recv() => match command {
                    Some(Command::Pose(sample)) => session.push_pose(sample),
                    Some(Command::Ping) => session.ping(self.now()),
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
                    session.acknowledge(frame.begin.id, now.since(frame.begin.pose_time), frame.decode_time);
                }
                News::Frame(frame)
            }
            Event::Statistics(statistics) => News::Statistics(statistics),
            Event::RoundTrip(time) => News::RoundTrip(time),
        };
        // Nobody listens any more: the command to close is on its way.
        let _ = self.news.send(news);
        Ok(())
    }
}

/// Writes some of `bytes`; where there are none, what is held back.
async fn push(writer: &mut (impl AsyncWrite + Unpin), bytes: &[u8]) -> io::Result<usize> {
    if bytes.is_empty() {
        return writer.flush().await.map(|()| 0);
    }
    match writer.write(bytes).await? {
        0 => Err(io::ErrorKind::WriteZero.into()),
        taken => Ok(taken),
    }
}

/// Connects, by attempts that overlap; the first that comes to an end decides.
async fn connect(endpoint: &Endpoint) -> io::Result<Box<dyn Stream>> {
    let mut attempts = JoinSet::new();
    loop {
        let endpoint = endpoint.clone();
        attempts.spawn(async move { timeout(CONNECT_TIMEOUT, endpoint.open()).await });
        if let Ok(Some(first)) = timeout(NEXT_ATTEMPT, attempts.join_next()).await {
            let in_time = first.map_err(io::Error::other)?;
            return in_time.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()));
        }
    }
}

/// Waits for `awaited` while there is no session; nothing where the display says goodbye meanwhile.
async fn unless_closed<T>(
    awaited: impl Future<Output = T>,
    commands: &mut mpsc::UnboundedReceiver<Command>,
) -> Option<T> {
    tokio::pin!(awaited);
    loop {
        tokio::select! {
            output = &mut awaited => return Some(output),
            command = commands.recv() => if matches!(command, None | Some(Command::Close)) {
                return None;
            },
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use tokio::net::{TcpSocket, TcpStream};

    /// A listener whose queue is full drops what comes, as a link does that is cut: TCP itself would ask again 1 s
    /// after the first time, in vain, and then at 2 s or 3 s, when the attempt is over.
    #[test]
    fn a_link_that_is_back_is_found_within_a_second() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let socket = TcpSocket::new_v4().unwrap();
            socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
            let listener = socket.listen(0).unwrap();
            let address = listener.local_addr().unwrap();
            let _fills_it = TcpStream::connect(address).await.unwrap();
            let mut cut = tokio::time::interval(Duration::from_millis(1200));
            cut.tick().await;
            let endpoint = Endpoint::plain(address.to_string());
            let connecting = connect(&endpoint);
            tokio::pin!(connecting);
            let early = tokio::select! {
                connected = &mut connecting => Some(connected),
                _ = cut.tick() => None,
            };
            assert!(early.is_none(), "connected over a link that is cut");
            let back = Instant::now();
            let _ = listener.accept().await.unwrap();
            assert!(connecting.await.is_ok());
            let taken = back.elapsed();
            assert!(taken < Duration::from_secs(1), "{taken:?}");
        });
    }
}
