//! What the program and the system know of this process.

/// The program with its version, as results name their maker.
pub const PROGRAM: &str = concat!("rilievo ", env!("CARGO_PKG_VERSION"));

/// CPU time of this process so far, of all its threads, seconds.
pub fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Largest resident memory since [`forget_peak_memory`], or since the start, bytes; `None` where the
/// system does not report it.
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib * 1024)
}

/// Has the allocator give freed memory back to the system: large blocks at once from now on, and what is free already.
/// Without it, what a stage freed is still counted as the process's in the next one, and `--memory` would not hold.
pub fn give_back_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // Blocks of this size and more are mapped one by one; smaller ones are reused faster than
        // the system maps them.
        const LARGE_BLOCK: libc::c_int = 4 << 20;
        #[expect(unsafe_code, reason = "the allocator is set through the C library")]
        // SAFETY: both functions may be called at any time, from any thread (mallopt(3), malloc_trim(3)).
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BLOCK);
            libc::malloc_trim(0);
        }
    }
}

/// Starts counting the peak anew, so that each stage has its own; where the system does not allow
/// it, a stage's peak is the largest so far.
pub fn forget_peak_memory() {
    // proc(5): 5 resets the peak resident set size to the current one.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
