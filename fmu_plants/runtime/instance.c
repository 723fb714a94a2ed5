/* Life cycle of an instance, how a call is refused, values of variables, saved states. */
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

bool known(const Instance *instance, unsigned reference, const char *function)
{
    if (reference < model.n_variables) return true;
    refuse(instance, STATUS_ERROR, "%s: there is no variable with value reference %u.", function, reference);
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
    if (instance->type == MODEL_EXCHANGE && !model.derivatives) return "this FMU is for Co-Simulation only";
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

/* Communication steps. */

double time_tolerance(double time, double step)
{
    return 1e-10 * fabs(time) + 1e-6 * step;
}

Status check_step(const Instance *instance, double start, double size, const char *function)
{
    const double time = simulation_time(instance->simulation);
    if (!(size > 0.0 && isfinite(size))) {
        return refuse(instance, STATUS_ERROR, "%s: the communication step size %g is not positive and finite.",
                      function, size);
    }
    if (!(fabs(start - time) <= time_tolerance(time, size))) {
        return refuse(instance, STATUS_ERROR, "%s: the communication point is %.10g, the instance is at %.10g.",
                      function, start, time);
    }
    if (start + size > instance->stop_time + time_tolerance(instance->stop_time, size)) {
        return refuse(instance, STATUS_ERROR, "%s: the step ends at %.10g, after the stop time %.10g.", function,
                      start + size, instance->stop_time);
    }
    return STATUS_OK;
}

/* Values of variables; all variables are floating point numbers of double precision. */

/* The modes in which a variable may be set, none for what the model computes. */
static unsigned settable_in(VariableKind kind)
{
    switch (kind) {
    case VARIABLE_STATE:
    case VARIABLE_FIXED_PARAMETER: return MODES_BEFORE_SIMULATION;
    case VARIABLE_TUNABLE_PARAMETER: return MODES_BEFORE_SIMULATION | MODE_STEP | MODE_EVENT;
    case VARIABLE_INPUT:
    case VARIABLE_SAMPLE: return MODES_BEFORE_SIMULATION | MODES_SIMULATING;
    case VARIABLE_TIME:
    case VARIABLE_DERIVATIVE:
    case VARIABLE_OUTPUT:
    case VARIABLE_HELD: return 0;
    }
    return 0;
}

/* Whether a variable can have this value: any finite one, and a sample may be missing. */
static bool possible(unsigned reference, double value)
{
    return isfinite(value) || (isnan(value) && model.variables[reference].kind == VARIABLE_SAMPLE);
}

Status instance_get(Instance *instance, const unsigned references[], size_t n, double values[], const char *function)
{
    Status status = STATUS_OK;
    if (!allowed(instance, MODES_READABLE, function)) return STATUS_ERROR;
    if (!present(instance, references, n, function) || !present(instance, values, n, function)) return STATUS_ERROR;
    simulation_refresh(instance->simulation);
    for (size_t i = 0; i < n; ++i) {
        if (!known(instance, references[i], function)) return STATUS_ERROR;
        values[i] = simulation_value(instance->simulation, references[i]);
        if (!possible(references[i], values[i])) {
            status = refuse(instance, STATUS_ERROR, "%s: %s is not finite at time %.10g.", function,
                            model.variables[references[i]].name, simulation_time(instance->simulation));
        }
    }
    return status;
}

static Status check_mode(const Instance *instance, const Variable *variable, const char *function)
{
    const unsigned modes = settable_in(variable->kind);
    if (modes & instance->mode) return STATUS_OK;
    if (!modes) {
        return refuse(instance, STATUS_ERROR, "%s: %s is computed by the model and cannot be set.", function,
                      variable->name);
    }
    if (variable->kind == VARIABLE_TUNABLE_PARAMETER) {
        return refuse(instance, STATUS_ERROR, "%s: %s cannot be set in continuous-time mode, only in event mode.",
                      function, variable->name);
    }
    return refuse(instance, STATUS_ERROR, "%s: %s can only be set before or in initialization mode.", function,
                  variable->name);
}

/* What is wrong with giving this variable this value now. */
static Status check_setting(const Instance *instance, unsigned reference, double value, const char *function)
{
    if (!known(instance, reference, function)) return STATUS_ERROR;
    const Variable *variable = &model.variables[reference];
    const Status status = check_mode(instance, variable, function);
    if (status != STATUS_OK) return status;
    if (!possible(reference, value)) {
        return refuse(instance, STATUS_ERROR, "%s: the value for %s is not finite.", function, variable->name);
    }
    if (isnan(value) || (value >= variable->min && value <= variable->max)) return STATUS_OK;
    if (variable->kind == VARIABLE_INPUT) {
        return refuse(instance, STATUS_WARNING, "%s: %s = %g is outside its range of %g to %g.", function,
                      variable->name, value, variable->min, variable->max);
    }
    return refuse(instance, STATUS_DISCARD, "%s: %s = %g is outside its range of %g to %g; nothing was set.", function,
                  variable->name, value, variable->min, variable->max);
}

Status instance_set(Instance *instance, const unsigned references[], size_t n, const double values[],
                    const char *function)
{
    Status status = STATUS_OK;
    if (!allowed(instance, MODES_BEFORE_SIMULATION | MODES_SIMULATING, function)) return STATUS_ERROR;
    if (!present(instance, references, n, function) || !present(instance, values, n, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; ++i) {
        const Status checked = check_setting(instance, references[i], values[i], function);
        if (checked > STATUS_WARNING) return checked;
        if (checked > status) status = checked;
    }
    for (size_t i = 0; i < n; ++i) simulation_set_value(instance->simulation, references[i], values[i]);
    return status;
}

static Status no_variables(const Instance *instance, size_t n, const char *function)
{
    if (n == 0) return STATUS_OK;
    return refuse(instance, STATUS_ERROR, "%s: there are no such variables.", function);
}

Status instance_get_other_type(const Instance *instance, size_t n, const char *function)
{
    return allowed(instance, MODES_READABLE, function) ? no_variables(instance, n, function) : STATUS_ERROR;
}

Status instance_set_other_type(const Instance *instance, size_t n, const char *function)
{
    const unsigned modes = MODES_BEFORE_SIMULATION | MODES_SIMULATING;
    return allowed(instance, modes, function) ? no_variables(instance, n, function) : STATUS_ERROR;
}

/* Saving, restoring and serializing the complete state of an instance. */

/* A saved state is an array of numbers: these, then the state of the simulation. */
enum { SAVED_TYPE, SAVED_MODE, SAVED_EXPERIMENT_DEFINED, SAVED_STOP_TIME, SAVED_SIMULATION };

/* The serialized state is the model's GUID, its terminator, and those numbers in the machine's own format. */
static size_t state_bytes(void)
{
    return (SAVED_SIMULATION + simulation_state_size()) * sizeof(double);
}

static size_t guid_bytes(void)
{
    return strlen(model.guid) + 1;
}

Status instance_get_state(const Instance *instance, void **state, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function)) return STATUS_ERROR;
    double *saved = *state ? *state : malloc(state_bytes());
    if (!saved) return refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
    saved[SAVED_TYPE] = instance->type;
    saved[SAVED_MODE] = instance->mode;
    saved[SAVED_EXPERIMENT_DEFINED] = instance->experiment_defined;
    saved[SAVED_STOP_TIME] = instance->stop_time;
    simulation_save(instance->simulation, saved + SAVED_SIMULATION);
    *state = saved;
    return STATUS_OK;
}

Status instance_set_state(Instance *instance, const void *state, const char *function)
{
    const double *saved = state;
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, saved, 1, function)) return STATUS_ERROR;
    if (saved[SAVED_TYPE] != (double)instance->type) {
        return refuse(instance, STATUS_ERROR, "%s: the state was saved by an instance of the other interface type.",
                      function);
    }
    instance->mode = (Mode)saved[SAVED_MODE];
    instance->experiment_defined = saved[SAVED_EXPERIMENT_DEFINED] != 0.0;
    instance->stop_time = saved[SAVED_STOP_TIME];
    simulation_restore(instance->simulation, saved + SAVED_SIMULATION);
    return STATUS_OK;
}

Status instance_free_state(const Instance *instance, void **state, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return STATUS_OK;
}

Status instance_serialized_size(const Instance *instance, const void *state, size_t *size, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function) || !present(instance, size, 1, function)) return STATUS_ERROR;
    *size = guid_bytes() + state_bytes();
    return STATUS_OK;
}

Status instance_serialize(const Instance *instance, const void *state, void *bytes, size_t size,
                          const char *function)
{
    const size_t needed = guid_bytes() + state_bytes();
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function) || !present(instance, bytes, 1, function)) return STATUS_ERROR;
    if (size < needed) {
        return refuse(instance, STATUS_ERROR, "%s: %zu bytes are needed, %zu were given.", function, needed, size);
    }
    memcpy(bytes, model.guid, guid_bytes());
    memcpy((char *)bytes + guid_bytes(), state, state_bytes());
    return STATUS_OK;
}

Status instance_deserialize(const Instance *instance, const void *bytes, size_t size, void **state,
                            const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, bytes, 1, function) || !present(instance, state, 1, function)) return STATUS_ERROR;
    if (size != guid_bytes() + state_bytes() || memcmp(bytes, model.guid, guid_bytes()) != 0) {
        return refuse(instance, STATUS_ERROR, "%s: this is not a state of model %s with GUID %s.", function,
                      model.identifier, model.guid);
    }
    double *saved = *state ? *state : malloc(state_bytes());
    if (!saved) return refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
    memcpy(saved, (const char *)bytes + guid_bytes(), state_bytes());
    *state = saved;
    return STATUS_OK;
}
