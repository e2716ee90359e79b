//! A connection's socket: it gives up a client that takes nothing, and ends so that the last answer is heard.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, Sleep, sleep};

/// How long what a client still sends is read and thrown away at the end.
const LINGER: Duration = Duration::from_secs(1);
/// And how much of it, in bytes.
const LINGER_BYTES: usize = 4 << 20;

pub(super) struct Socket {
    stream: TcpStream,
    patience: Duration,
    /// Runs while a write waits for the client.
    alarm: Pin<Box<Sleep>>,
    waits: bool,
    end: End,
}

/// How far the end has come.
enum End {
    Open,
    /// Nothing more is sent; what still comes is thrown away until the alarm, and until so many bytes.
    Lingering(usize),
    Closed,
}

impl Socket {
    /// `patience`: how long a client may take nothing of what it is sent.
    pub(super) fn new(stream: TcpStream, patience: Duration) -> Self {
        // Events and answers are small and are wanted at once.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!("a socket keeps its delay: {error}");
        }
        Self { stream, patience, alarm: Box::pin(sleep(patience)), waits: false, end: End::Open }
    }

    /// Passes on how a write went, and gives up when none has gone on for too long.
    fn watched<T>(&mut self, context: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.waits = false;
            return written;
        }
        if !self.waits {
            self.waits = true;
            self.alarm.as_mut().reset(Instant::now() + self.patience);
        }
        ready!(self.alarm.as_mut().poll(context));
        Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client takes nothing")))
    }

    /// Closing a socket in which something unread lies makes the kernel break the connection off, and the client
    /// may lose an answer that it has not read: so what it was still sending is read first, for a while.
    fn poll_linger(&mut self, context: &mut Context<'_>, mut left: usize) -> Poll<io::Result<()>> {
        let mut bytes = [0; 4096];
        loop {
            let mut buffer = ReadBuf::new(&mut bytes);
            match Pin::new(&mut self.stream).poll_read(context, &mut buffer) {
                Poll::Ready(Ok(())) if !buffer.filled().is_empty() && left > buffer.filled().len() => {
                    left -= buffer.filled().len();
                }
                // It may be about to send: a body that was refused by its head has not come yet.
                Poll::Pending if self.alarm.as_mut().poll(context).is_pending() => {
                    self.end = End::Lingering(left);
                    return Poll::Pending;
                }
                _ => {
                    self.end = End::Closed;
                    return Poll::Ready(Ok(()));
                }
            }
        }
    }
}

impl AsyncRead for Socket {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Socket {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.watched(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.watched(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.end {
            End::Open => {
                ready!(Pin::new(&mut self.stream).poll_shutdown(context))?;
                self.alarm.as_mut().reset(Instant::now() + LINGER);
                self.poll_linger(context, LINGER_BYTES)
            }
            End::Lingering(left) => self.poll_linger(context, left),
            End::Closed => Poll::Ready(Ok(())),
        }
    }
}
