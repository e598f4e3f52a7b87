//! Sessions over TCP and real time: the only file of the server with sockets and a clock.
//!
//! One task per client owns its session; one thread beside it renders, another encodes pictures. Nothing is written ahead: the next
//! message is taken from the session only when the last has gone to the socket, so what is sent is as fresh
//! as the link allows.
//!
//! A client gets a place and the two threads when its hello has been accepted, and not before: until then it costs a
//! task and a buffer, of which there are at most [`MAX_HANDSHAKES`], for at most [`HANDSHAKE`], TLS included. One
//! that finds all [`MAX_SESSIONS`] places taken is told so; one that takes nothing for [`DEAD_PEER`] is closed. Who is
//! refused is logged in one line, which holds no secret. Connections that come faster than they can be refused in words are
//! dropped without.

mod tls;
mod token;

pub use tls::{Identity, IdentityError};
pub use token::{TOKEN_VARIABLE, TokenError, read_token};

use crate::pictures::{EncodeJob, PictureStream, RenderedPictures};
use crate::service::Service;
use crate::session::{DEAD_PEER, HANDSHAKE, RenderJob, ServerSession, SessionEnd};
use crate::stream::FrameStream;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, mpsc as jobs};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::timeout;
use warplight_protocol::Timestamp;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::PictureMessage;
use warplight_protocol::video::VideoError;

/// Sessions at a time; further clients are told so and closed.
pub const MAX_SESSIONS: usize = 16;
/// Clients at a time that have not said hello: each holds some 100 kB at most.
pub const MAX_HANDSHAKES: usize = 64;
/// A client that is told why its session ends has this long to take it.
const FAREWELL: Duration = Duration::from_millis(500);
/// The kernel holds this much unacknowledged: what a link of 100 ms carries at 20 Mbit/s.
const SEND_BUFFER_BYTES: u32 = 256 << 10;
/// And this much unsent: more would be delay that nobody can take back. A socket takes more when half of it has left,
/// so that a link of 0.1 Mbit/s still shows within [`DEAD_PEER`] that it moves.
const UNSENT_BYTES: u32 = 32 << 10;
/// What a session has learnt of costs is written so often.
const COSTS_EVERY: Duration = Duration::from_secs(30);
/// A session whose link takes nothing is asked again after this, though its timers are due.
const PATIENCE: Duration = Duration::from_millis(20);

/// Listens on `address`.
pub async fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { tokio::net::TcpSocket::new_v4()? } else { tokio::net::TcpSocket::new_v6()? };
    // A restarted server takes its port back at once; connected sockets inherit the buffer.
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(64)
}

/// Serves clients without TLS until the future is dropped.
pub async fn serve(listener: TcpListener, service: Service) -> io::Result<()> {
    serve_until(listener, service, None, std::future::pending()).await
}

/// Serves clients, through TLS where there is an identity, until `stop` is there; then all are told goodbye.
pub async fn serve_until(
    listener: TcpListener,
    service: Service,
    identity: Option<Identity>,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let house =
        House { service, identity, places: Arc::new(Semaphore::new(MAX_SESSIONS)), stopping: watch::channel(false).0 };
    let doors = Arc::new(Semaphore::new(MAX_HANDSHAKES));
    let mut sessions = JoinSet::new();
    let mut dropped = 0_u64;
    tokio::pin!(stop);
    loop {
        let (socket, peer) = tokio::select! {
            () = &mut stop => break,
            Some(_) = sessions.join_next() => continue,
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                // A client that is gone before it is accepted, or no descriptor left: not the end of the server.
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    tokio::time::sleep(Duration::from_millis(50)).await;
                    continue;
                }
            },
        };
        let Ok(door) = doors.clone().try_acquire_owned() else {
            dropped += 1;
            // The first, the tenth, the hundredth: a flood must not become one of the log.
            if dropped.to_string().trim_start_matches('1').bytes().all(|digit| digit == b'0') {
                tracing::warn!(%peer, dropped, "refused: {MAX_HANDSHAKES} clients have not said hello yet");
            }
            continue;
        };
        let house = house.clone();
        sessions.spawn(async move {
            match house.receive(socket, door).await {
                Ok(end) => tracing::info!(%peer, "session closed: {end}"),
                Err(error) => tracing::info!(%peer, "session lost: {error}"),
            }
        });
    }
    house.stopping.send_replace(true);
    // Who has not taken the goodbye by then is cut off.
    let _ = timeout(FAREWELL, async { while sessions.join_next().await.is_some() {} }).await;
    Ok(())
}

/// What all sessions share.
#[derive(Clone)]
struct House {
    service: Service,
    identity: Option<Identity>,
    places: Arc<Semaphore>,
    stopping: watch::Sender<bool>,
}

impl House {
    async fn receive(self, socket: TcpStream, door: OwnedSemaphorePermit) -> io::Result<SessionEnd> {
        let connected = Instant::now();
        socket.set_nodelay(true)?;
        #[cfg(target_os = "linux")]
        socket2::SockRef::from(&socket).set_tcp_notsent_lowat(UNSENT_BYTES)?;
        let Some(identity) = &self.identity else {
            return self.run_session(socket, connected, door).await;
        };
        let Ok(accepted) = timeout(HANDSHAKE, identity.accept(socket)).await else {
            return Err(io::Error::new(io::ErrorKind::TimedOut, "refused: no TLS within 5 s"));
        };
        let stream = accepted.map_err(|error| io::Error::other(format!("refused: no TLS: {error}")))?;
        self.run_session(stream, connected, door).await
    }

    async fn run_session(
        self,
        stream: impl AsyncRead + AsyncWrite,
        connected: Instant,
        door: OwnedSemaphorePermit,
    ) -> io::Result<SessionEnd> {
        let epoch = connected;
        let time_of =
            |instant: Instant| Timestamp { micros: instant.saturating_duration_since(epoch).as_micros() as u64 };
        let now = || time_of(Instant::now());
        let mut session = ServerSession::new(self.service.session.clone(), now());
        session.connected_at(time_of(connected));
        let mut stopping = self.stopping.subscribe();
        let mut door = Some(door);
        // With the place that it takes.
        let mut workers: Option<(OwnedSemaphorePermit, Workers)> = None;

        let (mut reader, mut writer) = tokio::io::split(stream);
        let mut received = vec![0; 16 << 10];
        let mut outgoing = Vec::new();
        let mut written = 0;
        // What TLS still holds.
        let mut is_flushed = true;
        let mut last_taken = Instant::now();
        let mut costs_written = Instant::now();
        loop {
            if workers.is_none() && session.is_open() {
                match self.places.clone().try_acquire_owned() {
                    Ok(place) => {
                        workers = Some((place, Workers::start(self.service.clone())?));
                        session.set_metrics(self.service.metrics.clone());
                        door = None;
                        tracing::info!("session opened");
                    }
                    Err(_) => session.close(SessionEnd::Busy(MAX_SESSIONS)),
                }
            }
            if let Some((_, workers)) = &workers
                && let Some(job) = session.poll_render(now())
            {
                workers.render.send(job).map_err(|_| io::Error::other("the rendering thread is gone"))?;
            }
            if written == outgoing.len() {
                outgoing.clear();
                written = 0;
                session.poll_transmit(now(), &mut outgoing);
            }
            if let Some((_, workers)) = &workers
                && let Some(job) = session.poll_encode(now())
            {
                workers.encode.send(job).map_err(|_| io::Error::other("the encoding thread is gone"))?;
            }
            if let Some(learnt) = session.costs()
                && (session.end().is_some() || costs_written.elapsed() >= COSTS_EVERY)
            {
                costs_written = Instant::now();
                let (service, learnt) = (self.service.clone(), learnt.clone());
                // Beside the session: a disk may take its time.
                tokio::task::spawn_blocking(move || service.refresh_costs(&learnt));
            }
            if let Some(end) = session.end().cloned() {
                while session.poll_transmit(now(), &mut outgoing) {}
                let farewell = async {
                    writer.write_all(&outgoing[written..]).await?;
                    writer.shutdown().await?;
                    // A socket that is closed before it is read empty takes back what it has sent.
                    while reader.read(&mut received).await? > 0 {}
                    io::Result::Ok(())
                };
                // Whether it is heard makes no difference any more.
                let _ = timeout(FAREWELL, farewell).await;
                drop(door);
                return Ok(end);
            }
            let is_waiting = written < outgoing.len() || !is_flushed;
            let mut wake = epoch + Duration::from_micros(session.next_timeout().micros);
            if is_waiting {
                wake = wake.max(Instant::now() + PATIENCE);
            } else {
                last_taken = Instant::now();
            }
            let progress = async {
                match &mut workers {
                    Some((_, workers)) => workers.progress.recv().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                read = reader.read(&mut received) => match read? {
                    0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                    bytes => session.on_bytes(now(), &received[..bytes]),
                },
                taken = push(&mut writer, &outgoing[written..]), if is_waiting => {
                    let bytes = taken?;
                    written += bytes;
                    is_flushed = bytes == 0;
                    last_taken = Instant::now();
                }
                Some(event) = progress => match event {
                    Progress::Strip { at, frame, bytes } => session.on_strip(time_of(at), frame, bytes),
                    Progress::End { at, frame, render_end, counters, pictures } => {
                        if let Some(pictures) = pictures {
                            session.on_pictures(frame, pictures);
                        }
                        session.on_render_end(time_of(at), frame, time_of(render_end), counters);
                    }
                    Progress::Encoded { at, frame, pictures } => {
                        session.on_encoded(time_of(at), frame, pictures.map_err(io::Error::other)?);
                    }
                },
                () = tokio::time::sleep_until(wake.into()) => session.on_timeout(now()),
                () = tokio::time::sleep_until((last_taken + DEAD_PEER).into()), if is_waiting => {
                    session.close(SessionEnd::Unread);
                }
                _ = stopping.wait_for(|&stopping| stopping) => session.close(SessionEnd::Stopping),
            }
        }
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

/// What the threads of a session report.
enum Progress {
    Strip {
        at: Instant,
        frame: FrameId,
        bytes: Vec<u8>,
    },
    /// With the pictures of the frame, not yet encoded.
    End {
        at: Instant,
        frame: FrameId,
        render_end: Instant,
        counters: Vec<(String, u64)>,
        pictures: Option<RenderedPictures>,
    },
    Encoded {
        at: Instant,
        frame: FrameId,
        pictures: Result<Vec<PictureMessage>, VideoError>,
    },
}

/// The threads of a session. Each ends with the sender of its jobs.
struct Workers {
    render: jobs::Sender<RenderJob>,
    encode: jobs::Sender<EncodeJob>,
    progress: mpsc::UnboundedReceiver<Progress>,
}

impl Workers {
    fn start(service: Service) -> io::Result<Workers> {
        let mut pictures = PictureStream::new(service.options.threads);
        let mut stream = FrameStream::new(service);
        let (encode, encode_receiver) = jobs::channel();
        let (render, render_receiver) = jobs::channel();
        // One frame is rendered at a time, so of this there is never more than that.
        let (rendered, progress) = mpsc::unbounded_channel();
        let encoded = rendered.clone();
        std::thread::Builder::new()
            .name("render".to_owned())
            .spawn(move || render_jobs(&render_receiver, &rendered, &mut stream))?;
        std::thread::Builder::new()
            .name("encode".to_owned())
            .spawn(move || encode_jobs(&encode_receiver, &encoded, &mut pictures))?;
        Ok(Workers { render, encode, progress })
    }
}

fn render_jobs(jobs: &jobs::Receiver<RenderJob>, progress: &mpsc::UnboundedSender<Progress>, stream: &mut FrameStream) {
    let render_end = std::sync::Mutex::new(Instant::now());
    for job in jobs {
        let frame = job.begin.id;
        let on_rendered = || {
            if let Ok(mut latest) = render_end.lock() {
                *latest = Instant::now();
            }
        };
        // Nobody listens once the session is over; then the jobs end as well.
        let on_strip = |bytes| drop(progress.send(Progress::Strip { at: Instant::now(), frame, bytes }));
        let pictures = stream.run(&job, &on_rendered, &on_strip);
        let at = Instant::now();
        let render_end = render_end.lock().map_or(at, |latest| *latest);
        let _ = progress.send(Progress::End { at, frame, render_end, counters: stream.counters(), pictures });
    }
}

fn encode_jobs(
    jobs: &jobs::Receiver<EncodeJob>,
    progress: &mpsc::UnboundedSender<Progress>,
    stream: &mut PictureStream,
) {
    for job in jobs {
        let pictures = stream.encode(&job);
        let _ = progress.send(Progress::Encoded { at: Instant::now(), frame: job.frame, pictures });
    }
}
