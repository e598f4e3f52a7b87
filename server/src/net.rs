//! Sessions over TCP and real time: the only file of the server with sockets and a clock.
//!
//! One task per client owns its session; one thread beside it renders, another encodes pictures. Nothing is written ahead: the next
//! message is taken from the session only when the last has gone to the socket, so what is sent is as fresh
//! as the link allows.

use crate::pictures::{EncodeJob, PictureStream, RenderedPictures};
use crate::service::Service;
use crate::session::{RenderJob, ServerSession, SessionEnd};
use crate::stream::FrameStream;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, mpsc as jobs};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use warplight_protocol::Timestamp;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::PictureMessage;
use warplight_protocol::video::VideoError;

/// Sessions at a time; further clients wait to be accepted.
pub const MAX_SESSIONS: usize = 8;
/// A client that is told why its session ends has this long to take it.
const FAREWELL: Duration = Duration::from_millis(500);
/// The kernel holds this much unsent: more would be delay that nobody can take back.
const SEND_BUFFER_BYTES: u32 = 256 << 10;

/// Listens on `address`.
pub async fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { tokio::net::TcpSocket::new_v4()? } else { tokio::net::TcpSocket::new_v6()? };
    // A restarted server takes its port back at once; connected sockets inherit the buffer.
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(16)
}

/// Serves clients until the future is dropped.
pub async fn serve(listener: TcpListener, service: Service) -> io::Result<()> {
    let places = Arc::new(Semaphore::new(MAX_SESSIONS));
    loop {
        let Ok(place) = places.clone().acquire_owned().await else {
            return Ok(());
        };
        let (socket, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            // A client that is gone before it is accepted, or no descriptor left: not the end of the server.
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let service = service.clone();
        tokio::spawn(async move {
            tracing::info!(%peer, "session opened");
            match run_session(socket, service).await {
                Ok(end) => tracing::info!(%peer, "session closed: {end}"),
                Err(error) => tracing::info!(%peer, "session lost: {error}"),
            }
            drop(place);
        });
    }
}

/// What the rendering thread reports.
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

async fn run_session(mut socket: TcpStream, service: Service) -> io::Result<SessionEnd> {
    socket.set_nodelay(true)?;
    let epoch = Instant::now();
    let time_of = |instant: Instant| Timestamp { micros: instant.saturating_duration_since(epoch).as_micros() as u64 };
    let now = || time_of(Instant::now());
    let mut session = ServerSession::new(service.session.clone(), now());
    let mut pictures = PictureStream::new(service.options.threads);
    let mut stream = FrameStream::new(service);
    let (encode_sender, encode_receiver) = jobs::channel();
    let (job_sender, job_receiver) = jobs::channel();
    let (progress_sender, mut progress) = mpsc::unbounded_channel();
    let encoded_sender = progress_sender.clone();
    // Each thread ends with the sender of its jobs.
    std::thread::Builder::new()
        .name("render".to_owned())
        .spawn(move || render_jobs(&job_receiver, &progress_sender, &mut stream))?;
    std::thread::Builder::new()
        .name("encode".to_owned())
        .spawn(move || encode_jobs(&encode_receiver, &encoded_sender, &mut pictures))?;

    let (mut reader, mut writer) = socket.split();
    let mut received = vec![0; 64 << 10];
    let mut outgoing = Vec::new();
    let mut written = 0;
    loop {
        if let Some(job) = session.poll_render(now()) {
            job_sender.send(job).map_err(|_| io::Error::other("the rendering thread is gone"))?;
        }
        if written == outgoing.len() {
            outgoing.clear();
            written = 0;
            session.poll_transmit(now(), &mut outgoing);
        }
        if let Some(job) = session.poll_encode() {
            encode_sender.send(job).map_err(|_| io::Error::other("the encoding thread is gone"))?;
        }
        if let Some(end) = session.end().cloned() {
            while session.poll_transmit(now(), &mut outgoing) {}
            let farewell = async {
                writer.write_all(&outgoing[written..]).await?;
                writer.shutdown().await
            };
            // Whether it is heard makes no difference any more.
            let _ = tokio::time::timeout(FAREWELL, farewell).await;
            return Ok(end);
        }
        let wake = epoch + Duration::from_micros(session.next_timeout().micros);
        tokio::select! {
            read = reader.read(&mut received) => match read? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                bytes => session.on_bytes(now(), &received[..bytes]),
            },
            sent = writer.write(&outgoing[written..]), if written < outgoing.len() => written += sent?,
            Some(event) = progress.recv() => match event {
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
        }
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
