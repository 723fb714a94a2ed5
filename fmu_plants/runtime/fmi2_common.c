/* FMI 2.0: inquiry, logging, life cycle (sections 2.1.2, 2.1.5, 2.1.6). */
#include "fmi2_instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The standard's names (section 2.2.4), also listed in modelDescription.xml. */
static const char *const LOG_CATEGORIES[] = {"logStatusWarning", "logStatusDiscard", "logStatusError", "logAll"};
enum { N_LOG_CATEGORIES = 4, ALL_CATEGORIES = (1 << N_LOG_CATEGORIES) - 1, FAULTS = 1 << 1 | 1 << 2 };

static unsigned category_of(fmi2Status status)
{
    return status == fmi2Warning ? 0 : status == fmi2Discard ? 1 : 2;
}

fmi2Status refuse(const Instance *instance, fmi2Status status, const char *format, ...)
{
    const unsigned category = category_of(status);
    char message[512];
    va_list arguments;
    if (!instance->callbacks.logger || !(instance->logged_categories & (1u << category))) return status;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    /* The message is complete and holds no format directive: many importers do not format it. */
    instance->callbacks.logger(instance->callbacks.componentEnvironment, instance->name, status,
                               LOG_CATEGORIES[category], message);
    return status;
}

static const char *name_of(Mode mode)
{
    switch (mode) {
    case MODE_INSTANTIATED: return "before initialization";
    case MODE_INITIALIZATION: return "in initialization mode";
    case MODE_STEP_COMPLETE: return "between communication steps";
    case MODE_TERMINATED: return "after the instance was terminated";
    case MODE_ERROR: return "after a failed step (only a reset or a saved state leads back)";
    }
    return "in an unknown mode";
}

bool allowed(const Instance *instance, unsigned modes, const char *function)
{
    if (!instance) return false;
    if (instance->mode & modes) return true;
    refuse(instance, fmi2Error, "%s cannot be called %s.", function, name_of(instance->mode));
    return false;
}

bool present(const Instance *instance, const void *array, size_t n, const char *function)
{
    if (array || n == 0) return true;
    refuse(instance, fmi2Error, "%s: an argument is NULL.", function);
    return false;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

/* The bit of a category, every bit for logAll, 0 if there is no such category. */
static unsigned bits_of(fmi2String category)
{
    if (!category) return 0;
    if (strcmp(category, "logAll") == 0) return ALL_CATEGORIES;
    for (unsigned i = 0; i < N_LOG_CATEGORIES; ++i) {
        if (strcmp(category, LOG_CATEGORIES[i]) == 0) return 1u << i;
    }
    return 0;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    Instance *instance = c;
    unsigned chosen = nCategories == 0 ? ALL_CATEGORIES : 0;
    if (!allowed(instance, MODE_ANY, "fmi2SetDebugLogging")) return fmi2Error;
    if (!present(instance, categories, nCategories, "fmi2SetDebugLogging")) return fmi2Error;
    for (size_t i = 0; i < nCategories; ++i) {
        const unsigned bits = bits_of(categories[i]);
        if (!bits) return refuse(instance, fmi2Error, "fmi2SetDebugLogging: unknown log category.");
        chosen |= bits;
    }
    instance->logged_categories = loggingOn ? chosen : 0;
    return fmi2OK;
}

static bool fits(const Instance *instance, fmi2Type type, fmi2String guid)
{
    if (!instance->name || !instance->name[0]) {
        refuse(instance, fmi2Error, "fmi2Instantiate: the instance name is missing.");
        return false;
    }
    if (type != fmi2CoSimulation) {
        refuse(instance, fmi2Error, "fmi2Instantiate: this FMU has Co-Simulation only.");
        return false;
    }
    if (!guid || strcmp(guid, model.guid) != 0) {
        refuse(instance, fmi2Error, "fmi2Instantiate: the GUID is not that of this binary, %s.", model.guid);
        return false;
    }
    return true;
}

static char *copy_of(const char *text)
{
    const size_t size = text ? strlen(text) + 1 : 1;
    char *copy = calloc(size, 1);
    if (copy && text) memcpy(copy, text, size);
    return copy;
}

static void start_over(Instance *instance)
{
    instance->mode = MODE_INSTANTIATED;
    instance->experiment_defined = false;
    instance->stop_time = INFINITY;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation; /* there are no resources */
    (void)visible;
    if (!functions) return NULL;
    Instance *instance = calloc(1, sizeof(Instance));
    if (!instance) return NULL;
    instance->callbacks = *functions;
    /* loggingOn is about debugging: why a call failed is said all the same. */
    instance->logged_categories = loggingOn ? ALL_CATEGORIES : FAULTS;
    instance->name = copy_of(instanceName);
    start_over(instance);
    if (fits(instance, fmuType, fmuGUID)) {
        instance->simulation = simulation_create();
        if (!instance->simulation) refuse(instance, fmi2Error, "fmi2Instantiate: out of memory.");
    }
    if (!instance->simulation) {
        fmi2FreeInstance(instance);
        return NULL;
    }
    return instance;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *instance = c;
    if (!instance) return;
    simulation_free(instance->simulation);
    free(instance->name);
    free(instance);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    Instance *instance = c;
    if (!allowed(instance, MODE_INSTANTIATED, "fmi2SetupExperiment")) return fmi2Error;
    if (!isfinite(startTime)) {
        return refuse(instance, fmi2Error, "fmi2SetupExperiment: the start time is not finite.");
    }
    if (stopTimeDefined && !(stopTime >= startTime)) {
        return refuse(instance, fmi2Error, "fmi2SetupExperiment: the stop time %g is before the start time %g.",
                      stopTime, startTime);
    }
    if (toleranceDefined && !(tolerance > 0.0 && isfinite(tolerance))) {
        return refuse(instance, fmi2Error, "fmi2SetupExperiment: the tolerance %g is not positive and finite.",
                      tolerance);
    }
    simulation_set_time(instance->simulation, startTime);
    simulation_set_tolerance(instance->simulation, toleranceDefined ? tolerance : model.relative_tolerance);
    instance->stop_time = stopTimeDefined ? stopTime : INFINITY;
    instance->experiment_defined = true;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, MODE_INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    if (!instance->experiment_defined) {
        return refuse(instance, fmi2Error, "fmi2EnterInitializationMode: call fmi2SetupExperiment first.");
    }
    instance->mode = MODE_INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, MODE_INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    instance->mode = MODE_STEP_COMPLETE;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, MODE_STEP_COMPLETE, "fmi2Terminate")) return fmi2Error;
    instance->mode = MODE_TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, MODE_ANY, "fmi2Reset")) return fmi2Error;
    simulation_reset(instance->simulation);
    start_over(instance);
    return fmi2OK;
}
