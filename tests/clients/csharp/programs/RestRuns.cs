// REST calls with their errors.

using System;
using System.Collections.Generic;
using System.Threading.Tasks;
using Adverb;

static class RestRuns
{
    internal static async Task<object> Run(string address, Dictionary<string, object> given)
    {
        var adverbs = new Dictionary<string, double> { { "x", 0.5 }, { "y", 0.2 } };
        using (var client = new AdverbClient(address, (string)given.OrNull("key"), 5.0))
            return new Dictionary<string, object>
            {
                { "verbs", await Try(async () => Array.ConvertAll(await client.VerbsAsync(), verb => verb.Name)) },
                { "describe", await Try(async () => (await client.DescribeAsync("arm3")).Skeleton.Names) },
                { "pose", await Try(async () => (await client.PoseAsync("arm3", adverbs, new PoseOptions {
                    Phase = 0.5 })).Values) },
                { "sequence", await Try(async () => Array.ConvertAll(await client.SequenceAsync("arm3", adverbs, 30.0),
                    row => row.Phase)) },
                { "artifact", await Try(async () => (await client.DownloadArtifactAsync("arm3")).Length) },
                { "unknown", await Try(async () => (await client.PoseAsync("arm4", adverbs)).Values) },
                { "missing", await Try(async () => (await client.PoseAsync("arm3",
                    new Dictionary<string, double>())).Values) },
            };
    }

    internal static async Task<object> Try<T>(Func<Task<T>> call)
    {
        try
        {
            return await call();
        }
        catch (AdverbException error)
        {
            return Error(error);
        }
    }

    internal static Dictionary<string, object> Error(AdverbException error)
    {
        return new Dictionary<string, object>
        {
            { "code", error.Code }, { "detail", error.Detail }, { "status", error.Status },
            { "request", error.RequestId },
        };
    }
}
