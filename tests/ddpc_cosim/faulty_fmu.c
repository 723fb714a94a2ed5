/* An integrator behind the functions of FMI 2.0 that goes wrong on purpose: its GUID names the fault.
 * Faults of a step begin at t = 0.5 s. Calls are noted in the file that FAULTY_FMU_CALLS names. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

typedef struct {
    char fault[40];
    fmi2CallbackFunctions callbacks;
    double u, y, gain, time;
    int count, on;
} Instance;

static void note(const char *call) {
    const char *path = getenv("FAULTY_FMU_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    if (file) {
        fprintf(file, "%s\n", call);
        fclose(file);
    }
}

static int is(fmi2Component c, const char *fault) { return strcmp(((Instance *)c)->fault, fault) == 0; }

static void say(fmi2Component c, fmi2Status status, const char *message) {
    Instance *i = c;
    i->callbacks.logger(i->callbacks.componentEnvironment, "faulty", status, "events", message, 42);
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Instance *i = calloc(1, sizeof *i);
    note("instantiate");
    strncpy(i->fault, guid, sizeof i->fault - 1);
    i->callbacks = *callbacks;
    i->gain = 1;
    i->count = 2;
    i->on = 1;
    if (is(i, "null")) {
        say(i, fmi2Error, "licence %d has expired");
        free(i);
        return NULL;
    }
    return i;
}

void fmi2FreeInstance(fmi2Component c) {
    note("free");
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop) {
    ((Instance *)c)->time = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return is(c, "init-error") ? fmi2Error : fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { note("terminate"); return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Instance *i = c;
    for (size_t k = 0; k < n; k++) {
        double known[] = {i->u, i->y, i->gain * i->u * i->count * i->on, i->gain};
        value[k] = known[vr[k]];
    }
    return is(c, "get-error") && i->time > 0.45 ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Instance *i = c;
    for (size_t k = 0; k < n; k++) *(vr[k] == 0 ? &i->u : &i->gain) = value[k];
    return is(c, "set-warning") ? fmi2Warning : fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    ((Instance *)c)->count = value[0];
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    ((Instance *)c)->on = value[0];
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_set) {
    Instance *i = c;
    note("step");
    if (is(c, "chatty")) {
        say(c, fmi2OK, "all is well, %d times");
        say(c, fmi2Warning, "nearly out of range");
    }
    if (time > 0.45) {
        if (is(c, "error")) { say(c, fmi2Error, "division by zero"); return fmi2Error; }
        if (is(c, "discard") || is(c, "terminated")) return fmi2Discard;
        if (is(c, "fatal")) return fmi2Fatal;
        if (is(c, "illegal")) return (fmi2Status)17;
        if (is(c, "nan")) { i->y = NAN; return fmi2OK; }
    }
    i->y += i->gain * i->u * h;
    i->time = time + h;
    return is(c, "warning") ? fmi2Warning : fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = is(c, "terminated");
    return fmi2OK;
}

/* Nothing below is used. */
#define UNUSED(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
UNUSED(fmi2GetInteger, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
UNUSED(fmi2GetBoolean, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
UNUSED(fmi2GetString, const fmi2ValueReference vr[], size_t n, fmi2String value[])
UNUSED(fmi2SetString, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
UNUSED(fmi2GetFMUstate, fmi2FMUstate *state)
UNUSED(fmi2SetFMUstate, fmi2FMUstate state)
UNUSED(fmi2FreeFMUstate, fmi2FMUstate *state)
UNUSED(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
UNUSED(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
UNUSED(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
UNUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[], size_t nv, const fmi2Real dv[], fmi2Real dz[])
UNUSED(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[])
UNUSED(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[])
UNUSED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
UNUSED(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
UNUSED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
UNUSED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
