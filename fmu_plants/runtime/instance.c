/* Life cycle of an instance, and how a call is refused. */
#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The names of FMI 2.0 (section 2.2.4), used with FMI 3.0 as well; also listed in modelDescription.xml. */
static const char *const LOG_CATEGORIES[] = {"logStatusWarning", "logStatusDiscard", "logStatusError", "logAll"};
enum { N_LOG_CATEGORIES = 4, ALL_CATEGORIES = (1 << N_LOG_CATEGORIES) - 1, FAULTS = 1 << 1 | 1 << 2 };

static unsigned category_of(Status status)
{
    return status == STATUS_WARNING ? 0 : status == STATUS_DISCARD ? 1 : 2;
}

Status refuse(const Instance *instance, Status status, const char *format, ...)
{
    const unsigned category = category_of(status);
    char message[512];
    va_list arguments;
    if (!instance->logger.callback || !(instance->logged_categories & (1u << category))) return status;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    instance->logger.log(instance, status, LOG_CATEGORIES[category], message);
    return status;
}

static const char *name_of(Mode mode)
{
    switch (mode) {
    case MODE_INSTANTIATED: return "before initialization";
    case MODE_INITIALIZATION: return "in initialization mode";
    case MODE_STEP: return "between communication steps";
    case MODE_EVENT: return "in event mode";
    case MODE_CONTINUOUS_TIME: return "in continuous-time mode";
    case MODE_TERMINATED: return "after the instance was terminated";
    case MODE_ERROR: return "after a failed step (only a reset or a saved state leads back)";
    }
    return "";
}

bool allowed(const Instance *instance, unsigned modes, const char *function)
{
    if (!instance) return false;
    if (instance->mode & modes) return true;
    refuse(instance, STATUS_ERROR, "%s cannot be called %s.", function, name_of(instance->mode));
    return false;
}

bool present(const Instance *instance, const void *array, size_t n, const char *function)
{
    if (array || n == 0) return true;
    refuse(instance, STATUS_ERROR, "%s: an argument is NULL.", function);
    return false;
}

bool paired(const Instance *instance, size_t n_references, size_t n_values, const char *function)
{
    if (!instance) return false;
    if (n_references == n_values) return true;
    refuse(instance, STATUS_ERROR, "%s: %zu values for %zu variables.", function, n_values, n_references);
    return false;
}

static void start_over(Instance *instance)
{
    instance->mode = MODE_INSTANTIATED;
    instance->experiment_defined = false;
    instance->stop_time = INFINITY;
}

/* What is wrong with instantiating this model; NULL if nothing is. */
static const char *fault_of(const Instance *instance, const char *token)
{
    if (!instance->name[0]) return "the instance name is missing";
    if (!token || strcmp(token, model.guid) != 0) return "the GUID or instantiation token is not that of this binary";
    return instance->simulation ? NULL : "out of memory";
}

Instance *instance_create(InterfaceType type, const char *name, const char *token, bool logging_on, Logger logger,
                          const char *function)
{
    const size_t length = name ? strlen(name) : 0;
    Instance *instance = calloc(1, sizeof(Instance) + length + 1);
    if (!instance) return NULL;
    if (length > 0) memcpy(instance->name, name, length);
    instance->type = type;
    instance->logger = logger;
    /* loggingOn is about debugging: why a call failed is said all the same. */
    instance->logged_categories = logging_on ? ALL_CATEGORIES : FAULTS;
    instance->simulation = simulation_create();
    start_over(instance);
    const char *fault = fault_of(instance, token);
    if (!fault) return instance;
    refuse(instance, STATUS_ERROR, "%s: %s.", function, fault);
    instance_free(instance);
    return NULL;
}

void instance_free(Instance *instance)
{
    if (!instance) return;
    simulation_free(instance->simulation);
    free(instance);
}

/* The bit of a category, every bit for logAll, 0 if there is no such category. */
static unsigned bits_of(const char *category)
{
    if (!category) return 0;
    if (strcmp(category, "logAll") == 0) return ALL_CATEGORIES;
    for (unsigned i = 0; i < N_LOG_CATEGORIES; ++i) {
        if (strcmp(category, LOG_CATEGORIES[i]) == 0) return 1u << i;
    }
    return 0;
}

Status instance_set_logging(Instance *instance, bool logging_on, size_t n, const char *const categories[],
                            const char *function)
{
    unsigned chosen = n == 0 ? ALL_CATEGORIES : 0;
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, categories, n, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; ++i) {
        const unsigned bits = bits_of(categories[i]);
        if (!bits) return refuse(instance, STATUS_ERROR, "%s: unknown log category.", function);
        chosen |= bits;
    }
    instance->logged_categories = logging_on ? chosen : 0;
    return STATUS_OK;
}

Status instance_define_experiment(Instance *instance, const double *tolerance, double start, const double *stop,
                                  const char *function)
{
    if (!allowed(instance, MODE_INSTANTIATED, function)) return STATUS_ERROR;
    if (!isfinite(start)) return refuse(instance, STATUS_ERROR, "%s: the start time is not finite.", function);
    if (stop && !(*stop >= start)) {
        return refuse(instance, STATUS_ERROR, "%s: the stop time %g is before the start time %g.", function, *stop,
                      start);
    }
    if (tolerance && !(*tolerance > 0.0 && isfinite(*tolerance))) {
        return refuse(instance, STATUS_ERROR, "%s: the tolerance %g is not positive and finite.", function,
                      *tolerance);
    }
    simulation_set_time(instance->simulation, start);
    simulation_set_tolerance(instance->simulation, tolerance ? *tolerance : model.relative_tolerance);
    instance->stop_time = stop ? *stop : INFINITY;
    instance->experiment_defined = true;
    return STATUS_OK;
}

Status instance_enter_initialization(Instance *instance, const char *function)
{
    if (!allowed(instance, MODE_INSTANTIATED, function)) return STATUS_ERROR;
    instance->mode = MODE_INITIALIZATION;
    return STATUS_OK;
}

Status instance_exit_initialization(Instance *instance, const char *function)
{
    if (!allowed(instance, MODE_INITIALIZATION, function)) return STATUS_ERROR;
    instance->mode = instance->type == CO_SIMULATION ? MODE_STEP : MODE_EVENT;
    return STATUS_OK;
}

Status instance_terminate(Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_SIMULATING, function)) return STATUS_ERROR;
    instance->mode = MODE_TERMINATED;
    return STATUS_OK;
}

Status instance_reset(Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    simulation_reset(instance->simulation);
    start_over(instance);
    return STATUS_OK;
}
