/* FMI 3.0: inquiry, life cycle, saved states, derivatives (section 2.3.2, 2.2.6 to 2.2.11). */
#include "fmi3Functions.h"
#include "instance.h"

static void log_message(const Instance *instance, Status status, const char *category, const char *message)
{
    const fmi3LogMessageCallback callback = (fmi3LogMessageCallback)instance->logger.callback;
    callback(instance->logger.environment, (fmi3Status)status, category, message);
}

static Logger logger_of(fmi3InstanceEnvironment environment, fmi3LogMessageCallback callback)
{
    return (Logger){log_message, (AnyFunction)callback, environment};
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    return (fmi3Status)instance_set_logging(instance, loggingOn, nCategories, categories, __func__);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)resourcePath; /* there are no resources */
    (void)visible;
    return instance_create(MODEL_EXCHANGE, instanceName, instantiationToken, loggingOn,
                           logger_of(instanceEnvironment, logMessage), __func__);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)resourcePath;
    (void)visible;
    (void)eventModeUsed; /* what the importer could do; the capability flags say that none of it is used */
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)nRequiredIntermediateVariables;
    (void)intermediateUpdate;
    return instance_create(CO_SIMULATION, instanceName, instantiationToken, loggingOn,
                           logger_of(instanceEnvironment, logMessage), __func__);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    if (logMessage) {
        logMessage(instanceEnvironment, fmi3Error, "logStatusError",
                   "fmi3InstantiateScheduledExecution: this FMU has Co-Simulation and Model Exchange only.");
    }
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    instance_free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    const Status status = instance_define_experiment(instance, toleranceDefined ? &tolerance : NULL, startTime,
                                                     stopTimeDefined ? &stopTime : NULL, __func__);
    return status == STATUS_OK ? (fmi3Status)instance_enter_initialization(instance, __func__) : (fmi3Status)status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return (fmi3Status)instance_exit_initialization(instance, __func__);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return (fmi3Status)instance_terminate(instance, __func__);
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    return (fmi3Status)instance_reset(instance, __func__);
}

static fmi3Status no_structural_parameters(const Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: this FMU has no structural parameters.", function);
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return no_structural_parameters(instance, __func__);
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return no_structural_parameters(instance, __func__);
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_get_state(instance, FMUState, __func__);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return (fmi3Status)instance_set_state(instance, FMUState, __func__);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_free_state(instance, FMUState, __func__);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    return (fmi3Status)instance_serialized_size(instance, FMUState, size, __func__);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    return (fmi3Status)instance_serialize(instance, FMUState, serializedState, size, __func__);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_deserialize(instance, serializedState, size, FMUState, __func__);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    if (!paired(instance, nKnowns, nSeed, __func__)) return fmi3Error;
    if (!paired(instance, nUnknowns, nSensitivity, __func__)) return fmi3Error;
    return (fmi3Status)instance_derivative(instance, false, knowns, nKnowns, seed, unknowns, nUnknowns, sensitivity,
                                           __func__);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    if (!paired(instance, nUnknowns, nSeed, __func__)) return fmi3Error;
    if (!paired(instance, nKnowns, nSensitivity, __func__)) return fmi3Error;
    return (fmi3Status)instance_derivative(instance, true, unknowns, nUnknowns, seed, knowns, nKnowns, sensitivity,
                                           __func__);
}
