/* FMI 3.0 Co-Simulation in front of the faults; what this slave does not serve is left out of the library. */
#include "faults.h"
#include "fmi3Functions.h"

#include <stdlib.h>

enum { U = 1, Y, FAULT, FAULT_TIME };

typedef struct {
    Model model;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Slave;

static void say(void *slave, const char *message) {
    Slave *self = slave;
    if (self->log)
        self->log(self->environment, fmi3Warning, "logAll", message);
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed, const fmi3ValueReference intermediate[],
                                         size_t n, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Slave *slave = calloc(1, sizeof *slave);
    if (slave) {
        slave->environment = environment;
        slave->log = log;
        slave->model.log = say;
        slave->model.environment = slave;
    }
    return slave;
}

void fmi3FreeInstance(fmi3Instance slave) { free(slave); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance slave, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stopDefined, fmi3Float64 stop) {
    return (fmi3Status)misbehave(&((Slave *)slave)->model, INITIALIZATION);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance slave) { return fmi3OK; }

fmi3Status fmi3Terminate(fmi3Instance slave) {
    return (fmi3Status)misbehave(&((Slave *)slave)->model, TERMINATE);
}

fmi3Status fmi3GetFloat64(fmi3Instance slave, const fmi3ValueReference references[], size_t n,
                          fmi3Float64 values[], size_t nValues) {
    Model *model = &((Slave *)slave)->model;
    for (size_t i = 0; i < n; i++)
        switch (references[i]) {
        case U: values[i] = model->u; break;
        case Y: values[i] = model->y; break;
        case FAULT_TIME: values[i] = model->fault_time; break;
        default: return fmi3Error;
        }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance slave, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t nValues) {
    Model *model = &((Slave *)slave)->model;
    for (size_t i = 0; i < n; i++)
        switch (references[i]) {
        case U: model->u = values[i]; break;
        case FAULT_TIME: model->fault_time = values[i]; break;
        default: return fmi3Error;
        }
    return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance slave, const fmi3ValueReference references[], size_t n, fmi3Int32 values[],
                        size_t nValues) {
    for (size_t i = 0; i < n; i++)
        values[i] = ((Slave *)slave)->model.fault;
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance slave, const fmi3ValueReference references[], size_t n,
                        const fmi3Int32 values[], size_t nValues) {
    for (size_t i = 0; i < n; i++)
        ((Slave *)slave)->model.fault = values[i];
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance slave, fmi3Float64 time, fmi3Float64 size, fmi3Boolean noSetFMUStatePrior,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Model *model = &((Slave *)slave)->model;
    int status = step(model, time, size);
    *eventHandlingNeeded = *earlyReturn = fmi3False;
    *terminateSimulation = model->wants_termination;
    *lastSuccessfulTime = status ? time : time + size;
    return (fmi3Status)status;
}
