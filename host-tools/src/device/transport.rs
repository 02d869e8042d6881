//! Lines of bytes to a device: serial ports and TCP.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serialport::SerialPort;

use super::Error;

/// How long a TCP connection may take.
const CONNECT: Duration = Duration::from_secs(3);

/// A line to a device. A read that has waited for its whole timeout fails with [`io::ErrorKind::TimedOut`] or
/// [`io::ErrorKind::WouldBlock`].
pub trait Transport: Read + Write {
    /// How long a read waits, above zero.
    ///
    /// # Errors
    /// What the system says.
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()>;
}

impl Transport for TcpStream {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))
    }
}

impl Transport for Box<dyn SerialPort> {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        SerialPort::set_timeout(&mut **self, timeout).map_err(Into::into)
    }
}

impl Transport for Box<dyn Transport> {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        (**self).set_timeout(timeout)
    }
}

/// Opens `tcp:HOST:PORT` or a serial device, which runs at `baud`.
///
/// # Errors
/// [`Error::Open`], [`Error::Resolve`] or [`Error::Connect`].
pub fn open(port: &str, baud: u32) -> Result<Box<dyn Transport>, Error> {
    match port.strip_prefix("tcp:") {
        Some(address) => tcp(port.to_owned(), address),
        None => serial(port, baud).map_err(|source| Error::Open { port: port.to_owned(), source }),
    }
}

fn tcp(port: String, address: &str) -> Result<Box<dyn Transport>, Error> {
    use std::net::ToSocketAddrs;
    let addresses = match address.to_socket_addrs() {
        Ok(addresses) => addresses,
        Err(source) if source.kind() == ErrorKind::InvalidInput => return Err(Error::Open { port, source }),
        Err(source) => return Err(Error::Resolve { port, source }),
    };
    let mut failed = Error::Resolve { port: port.clone(), source: ErrorKind::NotFound.into() };
    for address in addresses {
        match connect(address) {
            Ok(stream) => return Ok(Box::new(stream)),
            Err(source) => failed = Error::Connect { port: port.clone(), source },
        }
    }
    Err(failed)
}

fn connect(address: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&address, CONNECT)?;
    // Requests are short and each waits for its answer.
    stream.set_nodelay(true)?;
    Ok(stream)
}

fn serial(port: &str, baud: u32) -> io::Result<Box<dyn Transport>> {
    let mut line = serialport::new(port, baud).open()?;
    // USB serial devices take this for "someone listens"; lines without it need not.
    let _ = line.write_data_terminal_ready(true);
    Ok(Box::new(line))
}
