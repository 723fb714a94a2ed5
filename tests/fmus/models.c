#define _GNU_SOURCE
#include "models.h"

#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <io.h>
#define write _write
#define open_socket() (-1)
#else
#include <sys/socket.h>
#include <unistd.h>
#define open_socket() socket(AF_INET, SOCK_STREAM, 0)
#endif

enum { MEGABYTES = 100, LINE = 1000, LINES = MEGABYTES * 1000 };

static volatile int always = 1;
static int *volatile nowhere = NULL;

/* Note a call in the file that FAULTY_FMU_CALLS names. */
static void note(const char *call)
{
    const char *path = getenv("FAULTY_FMU_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    if (file) {
        fprintf(file, "%s\n", call);
        fclose(file);
    }
}

static void say(const Model *m, int status, const char *message)
{
    if (m->logging.say)
        m->logging.say(&m->logging, status, message);
}

static void set_start_values(Model *m)
{
    m->values[U] = m->values[V] = m->values[NAME_LENGTH] = 0.0;
    m->values[X] = m->kind == BALL ? 1.0 : 0.0;
    m->values[GRAVITY] = 9.81;
    m->values[RESTITUTION] = 0.7;
    m->values[RATE] = 1.0;
    m->values[COUNT] = m->kind == INTEGRATOR ? 2.0 : 0.0;
    m->values[ON] = 1.0;
}

void forget(Model *m)
{
    if (m->values[FAULT] == FORGETS_IN_SET_UP)
        set_start_values(m);
}

Model *create(const char *token, Logging logging)
{
    static const char *const names[] = {"lag", "ball", "stair", "relay", "integrator", "feed", "counter",
                                        "clocked"};
    const char *fault = strchr(token, ':');
    size_t length = fault ? (size_t)(fault - token) : strlen(token);
    int kind = 0;
    while (kind < 8 && (strlen(names[kind]) != length || strncmp(token, names[kind], length)))
        kind++;
    Model *m = kind < 8 ? calloc(1, sizeof *m) : NULL;
    if (!m)
        return NULL;
    note("instantiate");
    m->kind = (Kind)kind;
    m->logging = logging;
    m->next_event = -1.0;
    m->stop = INFINITY;
    set_start_values(m);
    m->values[FAULT] = fault ? atoi(fault + 1) : NO_FAULT;
    m->values[FAULT_TIME] = fault ? 0.5 : 0.0;
    m->feed[FEED_SIZE][0].i64 = 2;
    if (m->values[FAULT] != NO_INSTANCE)
        return m;
    say(m, ERROR, "licence %d has expired");
    free(m);
    return NULL;
}

void destroy(Model *m)
{
    note("free");
    free(m);
}

/* Tell whoever reads the pipe of this name, and never return. */
static void hang(void)
{
    const char *name = getenv("FAULT_PIPE");
    FILE *pipe = name ? fopen(name, "w") : NULL;
    if (pipe)
        fclose(pipe);
    while (always) {
    }
}

static int overflow_stack(volatile int depth)
{
    volatile char frame[4096];
    frame[0] = (char)depth;
    return always ? overflow_stack(depth + 1) + frame[0] : 0;
}

static void make_line(char line[LINE + 1])
{
    memset(line, 'x', LINE);
    line[LINE - 1] = '\n';
    line[LINE] = '\0';
}

static void flood_stream(FILE *stream)
{
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        fputs(line, stream);
    fflush(stream);
}

static void flood_descriptor(void)
{
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        if (write(1, line, LINE) < 0)
            return;
}

static void flood_log(const Model *m)
{
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        say(m, WARNING, line);
}

static void leave_a_file(void)
{
    char *name = tempnam(NULL, "left-");
    FILE *file = fopen(name, "w");
    if (file)
        fclose(file);
    free(name);
}

/* Open the file that FAULT_FILE names. */
static int open_file(const Model *m, const char *mode)
{
    const char *path = getenv("FAULT_FILE");
    FILE *file = path ? fopen(path, mode) : NULL;
    if (!file) {
        say(m, ERROR, "the file cannot be opened");
        return ERROR;
    }
    fclose(file);
    return OK;
}

static int connect_somewhere(const Model *m)
{
    int descriptor = open_socket();
    if (descriptor < 0) {
        say(m, ERROR, "there is no network");
        return ERROR;
    }
    return close(descriptor) ? ERROR : OK;
}

static void flush_denormals(void)
{
#if defined __x86_64__
    uint32_t mode;
    __asm__ volatile("stmxcsr %0" : "=m"(mode));
    mode |= 0x8040; /* results, and operands */
    __asm__ volatile("ldmxcsr %0" : : "m"(mode));
#elif defined __aarch64__
    uint64_t mode;
    __asm__ volatile("mrs %0, fpcr" : "=r"(mode));
    __asm__ volatile("msr fpcr, %0" : : "r"(mode | 1u << 24));
#endif
}

#ifdef FAST_MATH
__attribute__((constructor)) static void when_loaded(void) { flush_denormals(); }
#endif

static void change_arithmetic(const Model *m)
{
    switch ((Fault)m->values[FAULT]) {
    case ROUND_UP: fesetround(FE_UPWARD); break;
    case ROUND_TO_ZERO: fesetround(FE_TOWARDZERO); break;
    case FLUSH_DENORMALS: flush_denormals(); break;
    default: break;
    }
}

static int misbehave_in_step(Model *m)
{
    switch ((Fault)m->values[FAULT]) {
    case RETURN_ERROR: say(m, ERROR, "division by zero"); return ERROR;
    case RETURN_FATAL: return FATAL;
    case RETURN_ILLEGAL: return ILLEGAL;
    case MINUS_ONE_IN_STEP: return MINUS_ONE;
    case RETURN_DISCARD: return DISCARD;
    case DISCARD_AND_TERMINATE: m->terminate = 1; return DISCARD;
    case ASK_TO_TERMINATE: m->terminate = 1; return OK;
    case RETURN_NAN: m->values[X] = NAN; return OK;
    case RETURN_INFINITY: m->values[X] = INFINITY; return OK;
    case SEGMENTATION_FAULT: *nowhere = 1; return OK;
    case CALL_ABORT: abort();
    case CALL_EXIT: exit(3);
    case OVERFLOW_STACK: return overflow_stack(0);
    case HANG_IN_STEP: hang(); return OK;
    case FLOOD_LOG: flood_log(m); return OK;
    case FLOOD_STDOUT: flood_stream(stdout); return OK;
    case FLOOD_STDERR: flood_stream(stderr); return OK;
    case FLOOD_DESCRIPTOR: flood_descriptor(); return OK;
    case PRINT_AND_ABORT: flood_stream(stdout); fputs("division by zero\n", stderr); abort();
    case WRITE_A_FILE: return open_file(m, "w");
    case READ_A_FILE: return open_file(m, "r");
    case OPEN_A_SOCKET: return connect_somewhere(m);
    case LEAVE_A_FILE: leave_a_file(); return OK;
    case LOG_AT_EVERY_STEP: say(m, OK, "all is well, %d times"); say(m, WARNING, "nearly out of range"); return OK;
    default: return OK;
    }
}

int set_up(Model *m, double time, double stop)
{
    Fault fault = (Fault)m->values[FAULT];
    m->time = time;
    m->stop = stop;
    if (fault == HANG_IN_INITIALIZATION)
        hang();
    if (fault == CRASH_IN_INITIALIZATION)
        *nowhere = 1;
    return fault == ERROR_IN_INITIALIZATION ? ERROR : fault == MINUS_ONE_IN_INITIALIZATION ? MINUS_ONE : OK;
}

void initialise(Model *m)
{
    if (m->kind == STAIR)
        m->next_event = m->time + 1.0;
    m->in_event_mode = m->has_event_mode;
}

int terminate(Model *m)
{
    note("terminate");
    if (m->values[FAULT] == HANG_IN_TERMINATE)
        hang();
    if (m->values[FAULT] == CRASH_IN_TERMINATE)
        *nowhere = 1;
    return OK;
}

/* Whether the model has a fault, and the time for it has come. */
static bool shows(const Model *m, Fault fault)
{
    return m->values[FAULT] == fault && m->time > m->values[FAULT_TIME] - 1e-9;
}

int set_reals(Model *m, const unsigned references[], size_t n, const double values[])
{
    for (size_t i = 0; i < n; i++) {
        unsigned r = references[i];
        if (r == COUNT || r == DX || r == DV || r >= VALUES || (values[i] == -1.0 && m->kind != INTEGRATOR))
            return ERROR;
        /* One parameter is ignored, as too many FMUs do. */
        if (r != RESTITUTION || values[i] != 0.123)
            m->values[r] = values[i];
    }
    return shows(m, MINUS_ONE_WHEN_SET) ? MINUS_ONE : m->values[FAULT] == WARNING_WHEN_SET ? WARNING : OK;
}

int get_reals(const Model *m, const unsigned references[], size_t n, double values[])
{
    const double *v = m->values;
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= VALUES)
            return ERROR;
        values[i] = references[i] == SPEED  ? v[RATE] * v[U] * v[COUNT] * v[ON]
                    : references[i] == COPY ? v[X]
                                            : v[references[i]];
    }
    return shows(m, ERROR_WHEN_READ) ? ERROR : shows(m, MINUS_ONE_WHEN_READ) ? MINUS_ONE : OK;
}

/* References are unique among variables of one type, no more than that: 0 is a real input too. */
unsigned whole(unsigned reference) { return reference == 0 ? COUNT : reference; }

static int feed_through(Model *m)
{
    if (m->in_event_mode)
        return ERROR;
    memcpy(m->feed[100], m->feed[0], (FEED_STEPS - 100) * sizeof m->feed[0]);
    m->feed[FEED_STEPS][0].f64 += 1.0;
    return OK;
}

int step(Model *m, double time, double h)
{
    double *v = m->values;
    note("step");
    if (time + h > m->stop)
        return ERROR;
    if (time + h > v[FAULT_TIME] + 1e-9) {
        int status = misbehave_in_step(m);
        if (status != OK)
            return status;
    }
    m->time = time + h;
    switch (m->kind) {
    case LAG: v[X] = v[U] + (v[X] - v[U]) * exp(-v[RATE] * h); break;
    case INTEGRATOR: v[X] += v[RATE] * v[U] * h; break;
    case COUNTER: v[X] += 0.1 * (v[U] - v[X]); break; /* a lag of ten calls, however long they are */
    case FEED: return feed_through(m);
    default: break;
    }
    while (m->kind == STAIR && !m->terminate && m->time >= m->next_event)
        handle_event(m);
    if (m->time > v[FAULT_TIME] - 1e-9)
        change_arithmetic(m);
    return m->terminate ? DISCARD : v[FAULT] == RETURN_WARNING ? WARNING : OK;
}

size_t states(const Model *m) { return m->kind == STAIR || m->kind == CLOCKED ? 0 : m->kind == BALL ? 2 : 1; }

int derivatives(Model *m, double dx[])
{
    double *v = m->values;
    if (shows(m, MINUS_ONE_IN_STEP))
        return MINUS_ONE;
    if (m->time > v[FAULT_TIME] + 1e-9 && v[FAULT] != ASK_TO_TERMINATE) {
        int status = misbehave_in_step(m);
        if (status != OK)
            return status;
    }
    switch (m->kind) {
    case LAG: v[DX] = v[RATE] * (v[U] - v[X]); break;
    case BALL: v[DX] = v[V]; v[DV] = v[U] - v[GRAVITY]; break;
    case RELAY: v[DX] = v[RATE]; break;
    default: return OK;
    }
    if (m->time > v[FAULT_TIME] - 1e-9)
        change_arithmetic(m);
    dx[0] = v[DX];
    if (m->kind == BALL)
        dx[1] = v[DV];
    return OK;
}

void event_indicators(const Model *m, double z[]) { z[0] = m->values[X]; }

int handle_event(Model *m)
{
    double *v = m->values;
    if (shows(m, ASK_TO_TERMINATE))
        m->terminate = 1;
    if (m->kind == BALL && v[X] <= 0.0 && v[V] < 0.0) {
        v[X] = 1e-300;
        v[V] = -v[RESTITUTION] * v[V];
        v[COUNT] += 1.0;
        return 1;
    }
    if (m->kind == STAIR && m->time >= m->next_event) {
        v[COUNT] += 1.0;
        if (shows(m, EVENTS_WITHOUT_END))
            return 0;
        m->next_event += 1.0;
        m->terminate |= v[COUNT] >= 10.0;
    }
    if (m->kind == CLOCKED && m->ticks) { /* a sample-and-hold */
        v[COUNT] += m->ticks;
        v[X] = v[U];
        v[V] = m->time;
        m->ticks = 0;
    }
    if (m->kind == RELAY && v[X] > 1.0) {
        v[X] -= 1.0;
        v[COUNT] += 1.0;
        return 1;
    }
    return 0;
}

int ends_after_step(const Model *m)
{
    return m->values[FAULT] == ASK_TO_TERMINATE && m->time > m->values[FAULT_TIME] + 1e-9;
}

int completed_step(const Model *m) { return m->kind == RELAY && m->values[X] > 1.0; }

void *saved(const Model *m)
{
    Model *state = malloc(sizeof *state);
    *state = *m;
    memset(&state->logging, 0, sizeof state->logging);
    return state;
}

void restore(Model *m, const void *state)
{
    Logging logging = m->logging;
    *m = *(const Model *)state;
    m->logging = logging;
}

/* As bytes; a large one is followed by zeros. */
size_t state_size(const Model *m)
{
    return sizeof *m + (m->values[FAULT] == LARGE_STATE ? (size_t)1 << 27 : 0);
}

int deserialised(const Model *m, const void *bytes, size_t size, void **state)
{
    if (size != sizeof *m || ((const Model *)bytes)->kind != m->kind) {
        say(m, ERROR, "this is not a state of mine");
        return ERROR;
    }
    *state = saved(bytes);
    return OK;
}

size_t feed_length(const Model *m, unsigned reference)
{
    unsigned r = reference % 100;
    return r == 30 ? 6 : r >= 20 && r < 30 ? (size_t)m->feed[FEED_SIZE][0].i64 : 1;
}
