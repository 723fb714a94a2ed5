/* Models behind the front ends of three FMI versions: every kind of event, every type of variable, every fault.
   The text that an instance is created with (GUID or token) says which model it is, and after a colon the
   number of the fault that it shows from t = 0.5 s on. An integrator can be told both by its parameters too. */
#ifndef MODELS_H
#define MODELS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Value references of all models but FEED. */
enum { U = 0, X = 1, V = 2, GRAVITY = 3, RESTITUTION = 4, COUNT = 5, RATE = 6, DX = 7, DV = 8, NAME_LENGTH = 9,
       FAULT = 10, FAULT_TIME = 11, SPEED = 12, ON = 13, CLOCK = 14, COPY = 16, VALUES = 17 };

typedef enum { LAG, BALL, STAIR, RELAY, INTEGRATOR, FEED, COUNTER, CLOCKED } Kind;

enum { OK, WARNING, DISCARD, ERROR, FATAL, ILLEGAL = 17, MINUS_ONE = -1 };

/* In the order of Fault in builder.py. */
typedef enum {
    NO_FAULT,
    RETURN_WARNING,
    RETURN_ERROR,
    RETURN_FATAL,
    RETURN_ILLEGAL,
    RETURN_DISCARD,
    DISCARD_AND_TERMINATE,
    RETURN_NAN,
    RETURN_INFINITY,
    SEGMENTATION_FAULT,
    CALL_ABORT,
    CALL_EXIT,
    OVERFLOW_STACK,
    HANG_IN_STEP,
    HANG_IN_INITIALIZATION,
    HANG_IN_TERMINATE,
    CRASH_IN_INITIALIZATION,
    CRASH_IN_TERMINATE,
    ERROR_IN_INITIALIZATION,
    ERROR_WHEN_READ,
    WARNING_WHEN_SET,
    NO_INSTANCE,
    LOG_AT_EVERY_STEP,
    FLOOD_LOG,
    FLOOD_STDOUT,
    FLOOD_STDERR,
    FLOOD_DESCRIPTOR,
    LEAVE_A_FILE,
    PRINT_AND_ABORT,
    ASK_TO_TERMINATE,
    WRITE_A_FILE,
    READ_A_FILE,
    OPEN_A_SOCKET,
    NEEDS_EVENT_MODE,
    NO_CO_SIMULATION,
    MINUS_ONE_IN_STEP, /* of Model Exchange: when derivatives are asked for */
    MINUS_ONE_IN_INITIALIZATION,
    MINUS_ONE_WHEN_READ,
    MINUS_ONE_WHEN_SET,
    ROUND_UP,
    ROUND_TO_ZERO,
    FLUSH_DENORMALS, /* of Model Exchange, these three: when derivatives are asked for */
    EVENTS_WITHOUT_END, /* of STAIR */
    FORGETS_IN_SET_UP, /* fmi2SetupExperiment sets everything to its start value, as that of 20-sim's FMUs */
    LARGE_STATE, /* which has 128 MB as bytes */
} Fault;

/* What FEED passes through: reference r + 100 becomes what reference r is. References 20 to 29 are arrays whose
   length is the structural parameter FEED_SIZE; reference 30 is a 2 x 3 matrix. */
enum { FEED_SIZE = 1, FEED_STEPS = 199, FEED_REFERENCES = 200, LONGEST = 16 };
typedef union { double f64; float f32; int64_t i64; int32_t i32; int16_t i16; int8_t i8; bool b; } Value;

/* How a front end passes a message on: by say, which knows what the other two are. */
typedef struct Logging {
    void (*say)(const struct Logging *logging, int status, const char *message);
    const void *callback;
    void *environment;
} Logging;

typedef struct {
    Kind kind;
    double time, stop;
    double values[VALUES];
    double next_event; /* negative: none */
    int terminate;
    Logging logging;
    Value feed[FEED_REFERENCES][LONGEST];
    bool configuring, has_event_mode, in_event_mode;
    int updates, ticks;
} Model;

/* Each returns an FMI status, if nothing else is said. */
Model *create(const char *token, Logging logging); /* NULL: there is no such model, or it refuses */
void destroy(Model *m);
void forget(Model *m); /* go back to the start values, if the fault is that */
int set_up(Model *m, double time, double stop); /* enter initialisation; a stop time may be INFINITY */
void initialise(Model *m);                      /* leave it */
int terminate(Model *m);
int set_reals(Model *m, const unsigned references[], size_t n, const double values[]);
int get_reals(const Model *m, const unsigned references[], size_t n, double values[]);
unsigned whole(unsigned reference); /* what a reference of an integer or boolean variable stands for */
int step(Model *m, double time, double h);   /* Co-Simulation, not for BALL and RELAY */

size_t states(const Model *m);
int derivatives(Model *m, double dx[]);
void event_indicators(const Model *m, double z[]);
int handle_event(Model *m);         /* whether the states have jumped */
int completed_step(const Model *m); /* whether an event is wanted */
int ends_after_step(const Model *m);

/* Copies of an instance, which are its states: all but whom it tells its messages. */
void *saved(const Model *m);
void restore(Model *m, const void *state);
size_t state_size(const Model *m);
int deserialised(const Model *m, const void *bytes, size_t size, void **state);

size_t feed_length(const Model *m, unsigned reference);

#endif
