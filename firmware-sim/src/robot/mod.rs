//! The simulated robot: the firmware's own playback on simulated buses, chips and servos, with faults on purpose.
//!
//! | module | what it is |
//! |---|---|
//! | [`clock`] | virtual time |
//! | [`pca9685`], [`sts3215`] | register model and packet model of the chips |
//! | [`hardware`] | everything behind the buses: chips and motors |
//! | [`motor`] | a servo's mechanics: inertia, friction, and what hangs on it |
//! | [`wires`] | buses as the drivers see them, and the middleware that spoils them |
//! | [`faults`] | what goes wrong, and when |
//! | [`flash`] | NOR flash with the two slots for blobs |
//! | [`firmware`] | its start: blob, self-test, motions |
//! | [`simulation`] | a run: ticks, events, and what an oscilloscope would find |
//! | [`boots`] | a thousand starts, resets and brown-outs, and what the horns do |
//! | [`stage`], [`report`] | the main job's last stage, its figures, and what the viewer shows |

pub mod boots;
pub mod clock;
pub mod faults;
pub mod firmware;
pub mod flash;
pub mod hardware;
pub mod motor;
pub mod pca9685;
pub mod report;
pub mod simulation;
pub mod stage;
pub mod sts3215;
pub mod wires;

pub use faults::{Fault, Kind};
pub use hardware::Boot;
pub use report::{RobotReport, ShownRobot};
pub use simulation::{EndState, Event, Moment, Run, Scenario, run};
pub use stage::{Played, Stage};
