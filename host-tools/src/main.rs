//! The `motionette` program; everything is in [`motionette_host::cli`].

fn main() -> std::process::ExitCode {
    motionette_host::cli::main()
}
