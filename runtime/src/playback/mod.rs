//! Motion leaves memory and moves servos, safely.
//!
//! ```text
//! Motion ──► Feeder ──► queue of servo frames ──► Player::tick ──► Output ──► servos
//!            (thread: inverse kinematics)          (timer interrupt: interpolation, fades, limits)
//! ```
//!
//! - `robot`: what the robot is, read from a packed `robot.toml`. Knows no motion.
//! - `body`: how the body's segments are turned, from where its joints are. Knows no servos.
//! - `mapper`: servo angles from that, and back.
//! - `queue`: the lock-free queue between whoever makes motions and the interrupt that plays them.
//! - `player`: a tick of the servos, at a fixed cost; `control` is how it is ordered about and what it counts.
//! - `start`: how the robot gets from power coming up to its first motion.
//! - `interpolate`, `limiter`: its numerics, an angle each.
//! - [`output`]: commands onto pins and buses; the only part that knows hardware.
//!
//! ```
//! use motionette::playback::{Handles, MotionQueue, Robot, When};
//!
//! # fn run(robot: &Robot, motion: &motionette::Motion<'_>) -> Result<(), Box<dyn core::error::Error>> {
//! let mut line = MotionQueue::<12, 256>::new(); // in firmware a static cell
//! let Handles { mut feeder, mut player, control } = line.split(robot)?;
//! feeder.play(motion, When::Then)?; // in a thread: the generator is free again afterwards
//! let servos = player.tick(); // in the timer interrupt, `robot.tick_rate` times a second
//! let _microseconds = servos.commands;
//! control.stop(); // from anywhere
//! # Ok(()) }
//! ```
//!
//! A player takes its robot to stand at neutral. Only an [`output::Runner`] makes sure of it: it finds the servos before it moves them.
//! Whoever gives servos their commands without one says where they really stand, with [`Player::stand_at`].

#[doc(hidden)]
pub mod body;
#[doc(hidden)]
pub mod control;
#[doc(hidden)]
pub mod interpolate;
#[doc(hidden)]
pub mod limiter;
#[doc(hidden)]
pub mod mapper;
pub mod output;
#[doc(hidden)]
pub mod player;
#[doc(hidden)]
pub mod queue;
#[doc(hidden)]
pub mod robot;
#[doc(hidden)]
pub mod start;

pub use control::{Control, State, Status};
pub use mapper::{Mapper, reach};
pub use player::{Player, Servos};
pub use queue::{Feeder, Full, Handles, MotionQueue, When};
pub use robot::{Axis, Bus, Channel, Rest, Robot, RobotError};
pub use start::{Start, StartFault};

#[cfg(test)]
mod tests;
