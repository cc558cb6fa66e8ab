//! `rilievo`: photographs of a plain, matte object to an accurate, finely detailed 3D model.

use std::process::ExitCode;

fn main() -> ExitCode {
    rilievo::program()
}
