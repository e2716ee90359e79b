//! The listener: how many connections there may be, and how long each may keep us waiting.
//!
//! One task a connection; hyper reads the requests and gives up heads that drip. Bodies are watched in `intake`,
//! answers that nobody takes in `socket`. One connection too many is told so and closed. At the end, connections
//! without a request are closed at once, and the others when they are answered.

mod descriptors;
mod socket;
mod unread;

pub use descriptors::connections_that_fit;

use super::door::Patience;
use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket::Socket;
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use unread::Unread;

/// Largest head of a request, its first line included, in bytes.
const HEAD_LIMIT: usize = 32 * 1024;
/// What a connection reads and writes ahead, in bytes.
const BUFFER: usize = 128 * 1024;
/// So many are told at the same time that there are too many; the next ones wait in the kernel.
const TURNED_AWAY: usize = 64;
/// How long one of them may take to hear it.
const FAREWELL: Duration = Duration::from_secs(1);
/// Until the listener is asked again after the system had no descriptor left.
const BREATH: Duration = Duration::from_millis(500);

/// Where a request came in, and from where; with each request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// Our end.
    pub(super) local: SocketAddr,
    /// The other end.
    pub(super) peer: SocketAddr,
    /// How long this client may take.
    pub(super) patience: Patience,
}

/// Answers on `listener` until `closing` turns true and what was under way then has been answered.
pub(super) async fn answer(
    listener: TcpListener,
    router: Router,
    patience: Patience,
    closing: watch::Receiver<bool>,
) {
    let places = Arc::new(Semaphore::new(patience.connections));
    let farewells = Arc::new(Semaphore::new(TURNED_AWAY));
    let mut ending = closing.clone();
    loop {
        let (stream, peer) = tokio::select! {
            accepted = accept(&listener) => accepted,
            () = closed(&mut ending) => break,
        };
        if let Ok(place) = places.clone().try_acquire_owned() {
            tokio::spawn(converse(stream, peer, router.clone(), patience, closing.clone(), place));
        } else if let Ok(place) = farewells.clone().acquire_owned().await {
            tokio::spawn(turn_away(stream, place));
        }
    }
    drop(listener);
    // Every place is free again once the last connection has ended.
    let all = u32::try_from(patience.connections).unwrap_or(u32::MAX);
    drop(places.acquire_many(all).await);
}

/// Waits for the end.
async fn closed(closing: &mut watch::Receiver<bool>) {
    // An error says that nobody can close us any more: then it is the end, too.
    drop(closing.wait_for(|closing| *closing).await);
}

async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            // That one had gone before we came to the door.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset | ErrorKind::Interrupted
                ) => {}
            Err(error) => {
                tracing::warn!("no connection can be taken now: {error}");
                tokio::time::sleep(BREATH).await;
            }
        }
    }
}

/// One connection, to its end.
async fn converse(
    stream: TcpStream,
    peer: SocketAddr,
    router: Router,
    patience: Patience,
    mut closing: watch::Receiver<bool>,
    _place: OwnedSemaphorePermit,
) {
    let Ok(local) = stream.local_addr() else {
        return; // It has gone.
    };
    let arrival = Arrival { local, peer, patience };
    let router = TowerToHyperService::new(router);
    let unread = Unread::default();
    let socket = TokioIo::new(Socket::new(stream, patience.stalled, unread.clone()));
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(arrival);
        router.call(request.map(|body| unread.watch(body)))
    });
    let mut connection = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(patience.head)
            .max_header_size(HEAD_LIMIT)
            .max_buf_size(BUFFER)
            .serve_connection(socket, service)
    );
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = closed(&mut closing) => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        // Clients leave as they like: that is not ours to complain of.
        tracing::debug!(%peer, "a connection ended early: {error}");
    }
}

/// Says that there are too many, and sees to it that it is heard.
async fn turn_away(stream: TcpStream, _place: OwnedSemaphorePermit) {
    let mut socket = Socket::new(stream, FAREWELL, Unread::default());
    let farewell = async {
        // A client speaks first; what it asks was never going to be answered.
        let _some = socket.read(&mut [0; 1024]).await?;
        socket.write_all(TOO_MANY.as_bytes()).await?;
        socket.shutdown().await
    };
    // Whoever does not take it has had his answer.
    drop(tokio::time::timeout(FAREWELL, farewell).await);
}

/// The whole answer to one too many; there is no room to read what he asks.
const TOO_MANY: &str = concat!(
    "HTTP/1.1 503 Service Unavailable\r\n",
    "Content-Type: application/problem+json\r\n",
    "Retry-After: 5\r\n",
    "Connection: close\r\n",
    "\r\n",
    r#"{"status":503,"code":"too_many_connections","title":"Service Unavailable","#,
    r#""detail":"too many connections are open; close some or ask again later"}"#,
);
