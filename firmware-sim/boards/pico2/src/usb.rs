//! The device link over USB serial.

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_rp::Peri;
use embassy_rp::peripherals::USB;
use embassy_rp::usb::{Driver, InterruptHandler};
use embassy_time::{Duration, Instant, Timer};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, Config};
use heapless::Vec;
use motionette_link::message::LossAction;
use motionette_link::server::Silence;
use motionette_link::{Server, Store};
use static_cell::ConstStaticCell;

use crate::DEVICE_STATE;

embassy_rp::bind_interrupts!(struct Interrupts {
    USBCTRL_IRQ => InterruptHandler<USB>;
});

/// Bytes of a packet.
const PACKET: usize = 64;
/// Bytes that wait to be sent.
type Out = Vec<u8, 1024>;
/// Milliseconds without a word from the host after which it counts as gone.
const SILENCE: u32 = 5_000;

/// Serves the link for ever.
#[embassy_executor::task]
pub async fn serve(usb: Peri<'static, USB>, store: Store, finish_without_host: bool) {
    static CONFIGURATION: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);
    static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
    static STATE: static_cell::StaticCell<State<'static>> = static_cell::StaticCell::new();

    // The test identifiers of pid.codes: a product needs its own.
    let mut config = Config::new(0x1209, 0x0001);
    (config.manufacturer, config.product, config.serial_number) = (Some("motionette"), Some("pico2"), Some("1"));
    let driver = Driver::new(usb, Interrupts);
    let mut builder = Builder::new(driver, config, CONFIGURATION.take(), &mut [], &mut [], CONTROL.take());
    let mut serial = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let mut device = builder.build();

    let action = if finish_without_host { LossAction::Finish } else { LossAction::Hold };
    let mut server = Server::new(store, Silence { after_ms: SILENCE, action });
    let mut port = server.port();
    let link = async {
        let mut out = Out::new();
        let mut packet = [0; PACKET];
        loop {
            let received = select(serial.read_packet(&mut packet), Timer::after(Duration::from_millis(20))).await;
            let now = Instant::now().as_millis();
            let bytes = match received {
                Either::First(Ok(length)) => &packet[..length.min(PACKET)],
                Either::First(Err(_)) => {
                    // Unplugged: the server still has to notice that its host is gone.
                    Timer::after(Duration::from_millis(20)).await;
                    &[]
                }
                Either::Second(()) => &[],
            };
            // SAFETY: this task runs in the executor of `Shared::INTERRUPT`.
            let served = unsafe {
                DEVICE_STATE.in_interrupt(|state| {
                    server.receive(&mut port, now, bytes, state, &mut out);
                    server.poll(now, state, &mut out);
                })
            };
            if served.is_none() {
                continue;
            }
            while !out.is_empty() && serial.dtr() {
                let count = out.len().min(PACKET - 1);
                if serial.write_packet(&out[..count]).await.is_err() {
                    break;
                }
                out.rotate_left(count);
                out.truncate(out.len() - count);
            }
            if !serial.dtr() {
                // Nobody listens.
                server.hang_up(&port);
                out.clear();
            }
        }
    };
    join(device.run(), link).await;
}
