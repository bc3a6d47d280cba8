use std::fs;

/// Memory available to this process in bytes, limited by its cgroup, if the system reports it.
pub fn available_memory_bytes() -> Option<u64> {
    let whole = fs::read_to_string("/proc/meminfo").ok()?;
    let line = whole.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    let allowed = fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let allowed: Option<u64> = allowed.and_then(|text| text.trim().parse().ok());
    let whole = kibibytes.saturating_mul(1024);
    Some(allowed.map_or(whole, |allowed| allowed.min(whole)))
}
