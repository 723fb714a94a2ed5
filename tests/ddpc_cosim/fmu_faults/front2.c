/* FMI 2.0 Co-Simulation in front of the faults. */
#include "faults.h"
#include "fmi2Functions.h"

#include <stdlib.h>

enum { U, Y, FAULT, FAULT_TIME };

typedef struct {
    Model model;
    const fmi2CallbackFunctions *callbacks;
} Slave;

static void say(void *slave, const char *message) {
    const fmi2CallbackFunctions *callbacks = ((Slave *)slave)->callbacks;
    callbacks->logger(callbacks->componentEnvironment, "integrator", fmi2Warning, "logAll", "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Slave *slave = calloc(1, sizeof *slave);
    if (slave) {
        slave->callbacks = callbacks;
        slave->model.log = say;
        slave->model.environment = slave;
    }
    return slave;
}

void fmi2FreeInstance(fmi2Component slave) { free(slave); }

fmi2Status fmi2SetupExperiment(fmi2Component slave, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stopDefined, fmi2Real stop) {
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component slave) {
    return (fmi2Status)misbehave(&((Slave *)slave)->model, INITIALIZATION);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component slave) { return fmi2OK; }

fmi2Status fmi2Terminate(fmi2Component slave) {
    return (fmi2Status)misbehave(&((Slave *)slave)->model, TERMINATE);
}

fmi2Status fmi2GetReal(fmi2Component slave, const fmi2ValueReference references[], size_t n, fmi2Real values[]) {
    Model *model = &((Slave *)slave)->model;
    for (size_t i = 0; i < n; i++)
        switch (references[i]) {
        case U: values[i] = model->u; break;
        case Y: values[i] = model->y; break;
        case FAULT_TIME: values[i] = model->fault_time; break;
        default: return fmi2Error;
        }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component slave, const fmi2ValueReference references[], size_t n,
                       const fmi2Real values[]) {
    Model *model = &((Slave *)slave)->model;
    for (size_t i = 0; i < n; i++)
        switch (references[i]) {
        case U: model->u = values[i]; break;
        case FAULT_TIME: model->fault_time = values[i]; break;
        default: return fmi2Error;
        }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component slave, const fmi2ValueReference references[], size_t n,
                          fmi2Integer values[]) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] != FAULT)
            return fmi2Error;
        values[i] = ((Slave *)slave)->model.fault;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component slave, const fmi2ValueReference references[], size_t n,
                          const fmi2Integer values[]) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] != FAULT)
            return fmi2Error;
        ((Slave *)slave)->model.fault = values[i];
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component slave, fmi2Real time, fmi2Real size, fmi2Boolean noSetFMUStatePrior) {
    return (fmi2Status)step(&((Slave *)slave)->model, time, size);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component slave, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = ((Slave *)slave)->model.wants_termination;
    return kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}

/* The rest of the interface, which this slave does not serve. */
#define UNSERVED(name, ...) \
    fmi2Status name(fmi2Component slave, __VA_ARGS__) { return fmi2Error; }

fmi2Status fmi2Reset(fmi2Component slave) { return fmi2Error; }
fmi2Status fmi2CancelStep(fmi2Component slave) { return fmi2Error; }
UNSERVED(fmi2SetDebugLogging, fmi2Boolean on, size_t n, const fmi2String categories[])
UNSERVED(fmi2GetBoolean, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
UNSERVED(fmi2SetBoolean, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
UNSERVED(fmi2GetString, const fmi2ValueReference r[], size_t n, fmi2String v[])
UNSERVED(fmi2SetString, const fmi2ValueReference r[], size_t n, const fmi2String v[])
UNSERVED(fmi2GetFMUstate, fmi2FMUstate *state)
UNSERVED(fmi2SetFMUstate, fmi2FMUstate state)
UNSERVED(fmi2FreeFMUstate, fmi2FMUstate *state)
UNSERVED(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
UNSERVED(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
UNSERVED(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
UNSERVED(fmi2GetDirectionalDerivative, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[],
         size_t nv, const fmi2Real dv[], fmi2Real dz[])
UNSERVED(fmi2SetRealInputDerivatives, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
         const fmi2Real v[])
UNSERVED(fmi2GetRealOutputDerivatives, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
         fmi2Real v[])
UNSERVED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
UNSERVED(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
UNSERVED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
UNSERVED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
