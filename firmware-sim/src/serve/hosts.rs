//! Hosts behind TCP: each has a connection of its own, and none waits for another.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Instant;

use motionette_link::{Device, Port, Server, Sink};

/// Most connections at once; of more, the oldest that has no session is closed.
const CONNECTIONS: usize = 16;
/// Bytes that wait for a host to read them; of more, replies and events are dropped and counted, as on a board.
const OUT: usize = 4096;

/// One host's connection.
struct Connection {
    stream: TcpStream,
    port: Port,
    out: Box<heapless::Vec<u8, OUT>>,
}

impl Connection {
    fn new(stream: TcpStream, port: Port) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        Ok(Connection { stream, port, out: Box::default() })
    }

    /// What has come; `None`: the host is gone.
    fn read<'b>(&mut self, bytes: &'b mut [u8]) -> Option<&'b [u8]> {
        match self.stream.read(bytes) {
            Ok(0) => None,
            Ok(count) => bytes.get(..count),
            Err(error) if is_later(&error) => Some(&[]),
            Err(_) => None,
        }
    }

    /// Sends as much as the host takes now; false: it is gone.
    fn send(&mut self) -> bool {
        while !self.out.is_empty() {
            match self.stream.write(&self.out) {
                Ok(0) => return false,
                Ok(count) => {
                    self.out.rotate_left(count);
                    self.out.truncate(self.out.len() - count);
                }
                Err(error) => return is_later(&error),
            }
        }
        true
    }
}

/// Whether there is only nothing to be done now.
fn is_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Where events go when no host has a session: the status tells the same.
struct Nobody;

impl Sink for Nobody {
    fn room(&self) -> usize {
        usize::MAX
    }

    fn send(&mut self, _: &[u8]) {}
}

/// The link, and all hosts that are connected.
pub(super) struct Hosts {
    listener: TcpListener,
    connections: Vec<Connection>,
    server: Server,
    started: Instant,
}

impl Hosts {
    /// Nobody yet.
    ///
    /// # Errors
    /// What the system says.
    pub fn new(listener: TcpListener, server: Server) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        Ok(Hosts { listener, connections: Vec::new(), server, started: Instant::now() })
    }

    /// Answers whatever has come, takes new hosts in and lets go of those that are gone; waits for none. Whether anything came is returned.
    ///
    /// # Errors
    /// When no host can be taken in any more.
    pub fn serve(&mut self, device: &mut impl Device) -> io::Result<bool> {
        let Hosts { connections, server, .. } = self;
        let now = self.started.elapsed().as_millis() as u64;
        let mut bytes = [0; 2048];
        let mut busy = false;
        connections.retain_mut(|connection| {
            let Some(bytes) = connection.read(&mut bytes) else {
                server.hang_up(&connection.port);
                return false;
            };
            busy |= !bytes.is_empty();
            server.receive(&mut connection.port, now, bytes, device, &mut *connection.out);
            true
        });
        match connections.iter_mut().find(|connection| server.is_owner(&connection.port)) {
            Some(owner) => server.poll(now, device, &mut *owner.out),
            None => server.poll(now, device, &mut Nobody),
        }
        connections.retain_mut(|connection| {
            let there = connection.send();
            if !there {
                server.hang_up(&connection.port);
            }
            there
        });
        // Last, so that who has closed its connection before is gone when the next host says hello.
        self.take_in()?;
        Ok(busy)
    }

    fn take_in(&mut self) -> io::Result<()> {
        loop {
            let stream = match self.listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                // It has left already.
                Err(error) if matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) => continue,
                Err(error) => return Err(error),
            };
            if self.connections.len() >= CONNECTIONS
                && let Some(oldest) = self.connections.iter().position(|it| !self.server.is_owner(&it.port))
            {
                self.connections.remove(oldest);
            }
            let port = self.server.port();
            // One that cannot be set up is dropped.
            self.connections.extend(Connection::new(stream, port));
        }
    }
}
