//! Lines of bytes to a device: serial ports and TCP.

use std::io::{self, Read, Write};
use std::net::TcpStream;
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
/// [`Error::Open`].
pub fn open(port: &str, baud: u32) -> Result<Box<dyn Transport>, Error> {
    let opened = match port.strip_prefix("tcp:") {
        Some(address) => tcp(address),
        None => serial(port, baud),
    };
    opened.map_err(|source| Error::Open { port: port.to_owned(), source })
}

fn tcp(address: &str) -> io::Result<Box<dyn Transport>> {
    use std::net::ToSocketAddrs;
    let mut last = io::Error::new(io::ErrorKind::InvalidInput, "no such address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => {
                // Requests are short and each waits for its answer.
                stream.set_nodelay(true)?;
                return Ok(Box::new(stream));
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn serial(port: &str, baud: u32) -> io::Result<Box<dyn Transport>> {
    let mut line = serialport::new(port, baud).open()?;
    // USB serial devices take this for "someone listens"; lines without it need not.
    let _ = line.write_data_terminal_ready(true);
    Ok(Box::new(line))
}
