/* What the files of the FMI 2.0 front end share: the instance, its mode, and how a call is refused. */
#ifndef FMI2_INSTANCE_H
#define FMI2_INSTANCE_H

#include "fmi2Functions.h"
#include "simulation.h"

#include <stdbool.h>

/* States of the state machine of FMI 2.0, section 4.2.4, as bits so that a call can name all that allow it. */
typedef enum {
    MODE_INSTANTIATED = 1 << 0,
    MODE_INITIALIZATION = 1 << 1,
    MODE_STEP_COMPLETE = 1 << 2,
    MODE_TERMINATED = 1 << 3,
    MODE_ERROR = 1 << 4 /* an integration failed: only reset, a saved state or the end helps */
} Mode;

#define MODE_ANY (MODE_INSTANTIATED | MODE_INITIALIZATION | MODE_STEP_COMPLETE | MODE_TERMINATED | MODE_ERROR)

typedef struct {
    Simulation *simulation;
    Mode mode;
    bool experiment_defined; /* fmi2SetupExperiment was called */
    double stop_time;        /* INFINITY if undefined */
    char *name;
    fmi2CallbackFunctions callbacks;
    unsigned logged_categories; /* bits by position in the list of log categories */
} Instance;

/* Log the message (a printf format) in the category of the status, and return the status.
 * A refused call changes nothing: values, time and mode stay as they were. */
fmi2Status refuse(const Instance *instance, fmi2Status status, const char *format, ...);

/* Whether the call is legal in the present mode; logs why not. */
bool allowed(const Instance *instance, unsigned modes, const char *function);

/* Whether the array argument is there; logs if not. An empty array may be NULL. */
bool present(const Instance *instance, const void *array, size_t n, const char *function);

#endif
