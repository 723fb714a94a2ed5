/* An instance of the FMU with what the front ends of all FMI versions and interface types have in common.
 *
 * The functions here do what their counterparts of the standard ask for; `function` is the name of that
 * counterpart, for messages. Each refuses an instance that is NULL and a call that its mode does not allow.
 * A refused call changes nothing: values, time and mode stay as they were. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "simulation.h"

#include <stdbool.h>
#include <stddef.h>

/* Numbered as by FMI 2.0 and FMI 3.0. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } Status;

typedef enum { MODEL_EXCHANGE, CO_SIMULATION } InterfaceType;

/* The state machines of FMI 2.0 (3.2.3, 4.2.4) and FMI 3.0 (2.3), as bits so that a call can name all that allow
 * it. Co-Simulation goes from initialization to steps, Model Exchange to events and continuous time. */
typedef enum {
    MODE_INSTANTIATED = 1 << 0,
    MODE_INITIALIZATION = 1 << 1,
    MODE_STEP = 1 << 2,
    MODE_EVENT = 1 << 3,
    MODE_CONTINUOUS_TIME = 1 << 4,
    MODE_TERMINATED = 1 << 5,
    MODE_ERROR = 1 << 6 /* an integration failed: only reset, a saved state or the end helps */
} Mode;

#define MODES_BEFORE_SIMULATION (MODE_INSTANTIATED | MODE_INITIALIZATION)
#define MODES_SIMULATING (MODE_STEP | MODE_EVENT | MODE_CONTINUOUS_TIME)
#define MODES_READABLE (MODE_INITIALIZATION | MODES_SIMULATING | MODE_TERMINATED | MODE_ERROR)
#define MODES_ANY (MODE_INSTANTIATED | MODES_READABLE)

typedef struct Instance Instance;

typedef void (*AnyFunction)(void); /* to be cast back to its own type before it is called */

/* Where messages go, in the manner of the FMI version. */
typedef struct {
    void (*log)(const Instance *instance, Status status, const char *category, const char *message);
    AnyFunction callback; /* the importer's function, for `log` to call; NULL if there is none */
    void *environment;
} Logger;

struct Instance {
    Simulation *simulation;
    InterfaceType type;
    Mode mode;
    bool experiment_defined; /* tolerance, start and stop time are known */
    double stop_time;        /* INFINITY if undefined */
    Logger logger;
    unsigned logged_categories; /* bits by position in the list of log categories */
    char name[];
};

/* Log the message (a printf format) in the category of the status, and return the status. */
Status refuse(const Instance *instance, Status status, const char *format, ...);

/* Whether the call is legal in the present mode; logs why not. */
bool allowed(const Instance *instance, unsigned modes, const char *function);

/* Whether the array argument is there; logs if not. An empty array may be NULL. */
bool present(const Instance *instance, const void *array, size_t n, const char *function);

/* Whether there is a variable with the value reference; logs if not. */
bool known(const Instance *instance, unsigned reference, const char *function);

/* Whether there is one value per variable, all variables being scalars; logs if not. */
bool paired(const Instance *instance, size_t n_references, size_t n_values, const char *function);

/* Life cycle. */
Instance *instance_create(InterfaceType type, const char *name, const char *token, bool logging_on, Logger logger,
                          const char *function); /* NULL if it is refused */
void instance_free(Instance *instance);
Status instance_set_logging(Instance *instance, bool logging_on, size_t n, const char *const categories[],
                            const char *function);
Status instance_define_experiment(Instance *instance, const double *tolerance, double start, const double *stop,
                                  const char *function); /* a tolerance or stop time of NULL is undefined */
Status instance_enter_initialization(Instance *instance, const char *function);
Status instance_exit_initialization(Instance *instance, const char *function);
Status instance_terminate(Instance *instance, const char *function);
Status instance_reset(Instance *instance, const char *function);

/* Values by value reference. */
Status instance_get(Instance *instance, const unsigned references[], size_t n, double values[], const char *function);
Status instance_set(Instance *instance, const unsigned references[], size_t n, const double values[],
                    const char *function);
/* Access to variables of a type that there is none of: to no variable it succeeds, to any it fails. */
Status instance_get_other_type(const Instance *instance, size_t n, const char *function);
Status instance_set_other_type(const Instance *instance, size_t n, const char *function);

/* Jacobian times vector: what a seed of knowns does to unknowns; the adjoint takes its transpose, from a seed of
 * unknowns to knowns. */
Status instance_derivative(Instance *instance, bool adjoint, const unsigned from[], size_t n_from, const double seed[],
                           const unsigned to[], size_t n_to, double sensitivity[], const char *function);

/* Saved states. */
Status instance_get_state(const Instance *instance, void **state, const char *function);
Status instance_set_state(Instance *instance, const void *state, const char *function);
Status instance_free_state(const Instance *instance, void **state, const char *function);
Status instance_serialized_size(const Instance *instance, const void *state, size_t *size, const char *function);
Status instance_serialize(const Instance *instance, const void *state, void *bytes, size_t size,
                          const char *function);
Status instance_deserialize(const Instance *instance, const void *bytes, size_t size, void **state,
                            const char *function);

/* Co-Simulation. */

/* How far two times may lie apart that an importer computed in different ways (k * h, or h added k times). */
double time_tolerance(double time, double step);

/* Whether a step begins where the instance is, ends after that, and not after the stop time; logs if not. */
Status check_step(const Instance *instance, double start, double size, const char *function);

Status instance_do_step(Instance *instance, double start, double size, const char *function);

/* Model Exchange. */
Status instance_enter_event_mode(Instance *instance, const char *function);
Status instance_enter_continuous_time_mode(Instance *instance, const char *function);
Status instance_set_time(Instance *instance, double time, const char *function);
Status instance_set_states(Instance *instance, const double x[], size_t n, const char *function);
Status instance_get_states(const Instance *instance, double x[], size_t n, const char *function);
Status instance_get_derivatives(Instance *instance, double dx[], size_t n, const char *function);
Status instance_get_nominals(const Instance *instance, double nominals[], size_t n, const char *function);
Status instance_get_event_indicators(const Instance *instance, const double indicators[], size_t n,
                                     const char *function);

#endif
