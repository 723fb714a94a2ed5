"""What a process in the sandbox may ask of the kernel: an allow-list of what FMUs, compilers and Python need.

Whatever a kernel adds is refused until it stands here, and so is all that changes what a file may be used
for, even one that is open for reading, that watches what others do, or that makes a sandbox anew.
"""

from typing import NamedTuple

# Name, number on x86-64, number on ARM64 (-: not there); the kernel's tables:
# arch/x86/entry/syscalls/syscall_64.tbl, include/uapi/asm-generic/unistd.h.
_ALLOWED = {
    "Files that are open already": """
        read 0 63; write 1 64; readv 19 65; writev 20 66; pread64 17 67; pwrite64 18 68; preadv 295 69;
        pwritev 296 70; preadv2 327 286; pwritev2 328 287; lseek 8 62; close 3 57; close_range 436 436;
        dup 32 23; dup2 33 -; dup3 292 24; fcntl 72 25; ioctl 16 29; flock 73 32; fstat 5 80; fstatfs 138 44;
        fsync 74 82; fdatasync 75 83; ftruncate 77 46; fallocate 285 47; fadvise64 221 223;
        sync_file_range 277 84; sendfile 40 71; copy_file_range 326 285; getdents 78 -; getdents64 217 61;
        fchdir 81 50;
    """,
    "Files by name, which Landlock decides on": """
        open 2 -; openat 257 56; creat 85 -; truncate 76 45; stat 4 -; lstat 6 -; newfstatat 262 79;
        statx 332 291; statfs 137 43; access 21 -; faccessat 269 48; faccessat2 439 439; readlink 89 -;
        readlinkat 267 78; rename 82 -; renameat 264 38; renameat2 316 276; mkdir 83 -; mkdirat 258 34;
        rmdir 84 -; unlink 87 -; unlinkat 263 35; link 86 -; linkat 265 37; symlink 88 -; symlinkat 266 36;
        getcwd 79 17; chdir 80 49; umask 95 166;
    """,
    "Waiting": """
        poll 7 -; ppoll 271 73; select 23 -; pselect6 270 72; epoll_create 213 -; epoll_create1 291 20;
        epoll_ctl 233 21; epoll_wait 232 -; epoll_pwait 281 22; eventfd 284 -; eventfd2 290 19; pipe 22 -;
        pipe2 293 59; timerfd_create 283 85; timerfd_settime 286 86; timerfd_gettime 287 87;
    """,
    "Memory": """
        brk 12 214; mmap 9 222; munmap 11 215; mprotect 10 226; mremap 25 216; madvise 28 233; msync 26 227;
        mlock 149 228; munlock 150 229; memfd_create 319 279; membarrier 324 283;
    """,
    "Threads and programs": """
        clone 56 220; fork 57 -; vfork 58 -; execve 59 221; exit 60 93; exit_group 231 94; wait4 61 260;
        waitid 247 95; futex 202 98; set_robust_list 273 99; set_tid_address 218 96; rseq 334 293;
        arch_prctl 158 -; prctl 157 167; restart_syscall 219 128; sched_yield 24 124;
        sched_getaffinity 204 123; sched_setaffinity 203 122; sched_getparam 143 121; sched_setparam 142 118;
        sched_getscheduler 145 120; sched_setscheduler 144 119; sched_getattr 315 275; sched_setattr 314 274;
        sched_get_priority_max 146 125; sched_get_priority_min 147 126; sched_rr_get_interval 148 127;
        getcpu 309 168;
    """,
    "Signals": """
        rt_sigaction 13 134; rt_sigprocmask 14 135; rt_sigreturn 15 139; rt_sigpending 127 136;
        rt_sigsuspend 130 133; rt_sigtimedwait 128 137; sigaltstack 131 132; kill 62 129; tkill 200 130;
        tgkill 234 131; pause 34 -; alarm 37 -; getitimer 36 102; setitimer 38 103; timer_create 222 107;
        timer_settime 223 110; timer_gettime 224 108; timer_getoverrun 225 109; timer_delete 226 111;
    """,
    "Time": """
        time 201 -; gettimeofday 96 169; clock_gettime 228 113; clock_getres 229 114; clock_nanosleep 230 115;
        nanosleep 35 101; times 100 153;
    """,
    "Who and where it is, and what it may have": """
        getpid 39 172; getppid 110 173; gettid 186 178; getpgrp 111 -; getpgid 121 155; setpgid 109 154;
        getsid 124 156; setsid 112 157; getuid 102 174; geteuid 107 175; getgid 104 176; getegid 108 177;
        getresuid 118 148; getresgid 120 150; getgroups 115 158; capget 125 90; getpriority 140 141;
        getrlimit 97 163; setrlimit 160 164; prlimit64 302 261; getrusage 98 165; uname 63 160;
        sysinfo 99 179; getrandom 318 278;
    """,
    "Pairs of sockets": """
        socketpair 53 199; sendto 44 206; recvfrom 45 207; sendmsg 46 211; recvmsg 47 212; shutdown 48 210;
        getsockname 51 204; getpeername 52 205; getsockopt 55 209; setsockopt 54 208;
    """,
}
# Socket options, commands and the like that are allowed where not all are: of an argument, seen through a
# mask, some values.
_ALL, _SOCKET_TYPE = 0xFFFFFFFF, 0xF  # without its flags
_NEW_NAMESPACES, _SIBLING = 0x7E020000, 0x8000  # a sibling would not be counted with whoever starts it
_OWN = ((0, _ALL, (0,)),)  # of this process: a limit on CPU time ends another, one processor slows it down
_CONDITIONS = {
    # Duplicates, flags, locks, seals of own memory: no leases, no signals to others, no watching of folders.
    "fcntl": ((1, _ALL, (0, 1, 2, 3, 4, 5, 6, 7, 36, 37, 38, 1030, 1032, 1033, 1034)),),
    # Whether it is a terminal, and its size; bytes to read; whether it blocks; whether programs inherit it.
    "ioctl": ((1, _ALL, (0x5401, 0x802C542A, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)),),
    # Signal of the parent's death, names, timers' slack, orphans, no new privileges, and what only asks.
    "prctl": ((0, _ALL, (1, 2, 3, 15, 16, 21, 23, 29, 30, 36, 37, 38, 39, 42, 0x53564D41)),),
    "clone": ((0, _NEW_NAMESPACES | _SIBLING, (0,)),),
    # Local, and of streams: one end of a pair of datagrams can send to any service.
    "socketpair": ((0, _ALL, (1,)), (1, _SOCKET_TYPE, (1,))),
    # Type, error, sizes, time limits; of them, time limits are set.
    "getsockopt": (
        (1, _ALL, (1,)),
        (2, _ALL, (3, 4, 7, 8, 20, 21, 38, 39)),
    ),
    "setsockopt": ((1, _ALL, (1,)), (2, _ALL, (20, 21))),
    "prlimit64": _OWN,
    "sched_setaffinity": _OWN,
    "sched_setparam": _OWN,
    "sched_setscheduler": _OWN,
    "sched_setattr": _OWN,
}
# From here on (clone3) programs ask whether a call is there, and do without: of these, what is not allowed is
# said not to be there.
FIRST_NEW = 435


class Condition(NamedTuple):
    """The values that an argument, counted from 0, may have in the bits of a mask."""

    argument: int
    mask: int
    values: tuple[int, ...]


def allowed_calls(column: int) -> dict[int, tuple[Condition, ...]]:
    """Return the numbers of the allowed calls, each with its conditions, which all have to hold.

    Parameters
    ----------
    column : int
        Which processor's numbers: 0 for x86-64, 1 for ARM64.
    """
    calls = (entry.split() for group in _ALLOWED.values() for entry in group.strip(" ;\n").split(";"))
    return {
        int(numbers[column]): tuple(Condition(*condition) for condition in _CONDITIONS.get(name, ()))
        for name, *numbers in calls
        if numbers[column] != "-"
    }
