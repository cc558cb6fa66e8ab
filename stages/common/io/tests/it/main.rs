//! Tests of the formats from outside: hostile bytes, missing keys, other programs' files.

mod fuzz;
mod missing_keys;
mod mutations;
mod python_guide;
mod shared_data;
