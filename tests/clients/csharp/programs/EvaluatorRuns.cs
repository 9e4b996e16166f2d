// The evaluator against golden vectors and against a server, and its speed.

using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Text;
using System.Threading.Tasks;
using Adverb;

static class EvaluatorRuns
{
    /// <summary>Poses of the cases of tests/golden/evaluator_vectors.v1.json.</summary>
    internal static object Vectors(Dictionary<string, object> vectors, string root)
    {
        return vectors["verbs"].List().ConvertAll(row =>
        {
            Dictionary<string, object> verb = row.Map();
            VerbEvaluator evaluator = VerbEvaluator.Load(Path.Combine(root, (string)verb["file"]));
            return (object)new Dictionary<string, object>
            {
                { "weights", verb["weights"].List().ConvertAll(each => OfWeights(evaluator, each.Map())) },
                { "adverbs", verb["adverbs"].List().ConvertAll(each => OfAdverbs(evaluator, each.Map())) },
            };
        });
    }

    static object OfWeights(VerbEvaluator evaluator, Dictionary<string, object> at)
    {
        var pose = new EvaluatedPose();
        evaluator.PoseOf(at["weights"].Nums(), at["phase"].Num(), pose);
        return Row(evaluator, pose);
    }

    static object OfAdverbs(VerbEvaluator evaluator, Dictionary<string, object> at)
    {
        var adverbs = new Dictionary<string, double>();
        foreach (KeyValuePair<string, object> each in at["adverbs"].Map()) adverbs[each.Key] = each.Value.Num();
        object phase = at.OrNull("phase"), time = at.OrNull("time");
        var pose = new EvaluatedPose();
        evaluator.Pose(evaluator.Ordered(adverbs), phase == null ? double.NaN : phase.Num(), pose, (string)at["method"],
            time == null ? 0.0 : time.Num());
        return Row(evaluator, pose);
    }

    static object Row(VerbEvaluator evaluator, EvaluatedPose pose)
    {
        var positions = new float[3 * evaluator.Skeleton.Names.Length];
        evaluator.Skeleton.Solve(pose.Values, positions);
        return new Dictionary<string, object>
        {
            { "at", new[] { pose.Phase, pose.TimeS, pose.DurationS } }, { "clamped", pose.Clamped },
            { "weights", (double[])pose.Weights.Clone() }, { "positions", positions },
        };
    }

    /// <summary>Codes of files that are damaged, cut, no verb files, or newer, and of wrong arguments.</summary>
    internal static object Damage(string path)
    {
        byte[] file = File.ReadAllBytes(path), damaged = (byte[])file.Clone(), cut = new byte[file.Length - 8];
        damaged[damaged.Length - 3] ^= 1;
        Array.Copy(file, cut, cut.Length);
        Encoding latin = Encoding.GetEncoding("iso-8859-1");
        byte[] newer = latin.GetBytes(latin.GetString(file).Replace("\\\"format\\\": 1", "\\\"format\\\": 9"));
        byte[] deep = Encoding.UTF8.GetBytes("12345678" + new string('[', 100000));
        Array.Copy(BitConverter.GetBytes(100000L), deep, 8);
        var evaluator = new VerbEvaluator(file);
        var pose = new EvaluatedPose();
        var middle = evaluator.Middle();
        return new List<object>
        {
            Failure(() => new VerbEvaluator(damaged)), Failure(() => new VerbEvaluator(cut)),
            Failure(() => new VerbEvaluator(new byte[12])), Failure(() => new VerbEvaluator(new byte[64])),
            Failure(() => new VerbEvaluator(newer)), Failure(() => new VerbEvaluator(deep)),
            Failure(() => evaluator.Ordered(new Dictionary<string, double> { { "x", 0.5 } })),
            Failure(() => evaluator.Ordered(new Dictionary<string, double> { { "x", 0.5 }, { "y", 0.2 },
            { "z", 1.0 } })),
            Failure(() => evaluator.Pose(new[] { 0.5, double.NaN }, 0.5, pose)),
            Failure(() => evaluator.Pose(middle, 1.5, pose)), Failure(() => evaluator.Pose(middle, 0.5, pose, "magic")),
            Failure(() => evaluator.PoseOf(new double[1], 0.5, pose)), Failure(() => evaluator.Pose(middle, 0.5, pose)),
        };
    }

    static object Failure(Action what)
    {
        try
        {
            what();
            return null;
        }
        catch (AdverbException error)
        {
            return error.Code + ": " + error.Detail;
        }
    }

    /// <summary>Largest distance of a joint, m, of random poses of all verbs of a server, by REST and here.</summary>
    internal static async Task<object> Server(string address, int least)
    {
        var random = new Random(20);
        var worst = new Dictionary<string, object>();
        int poses = 0;
        using (var client = new AdverbClient(address))
        {
            VerbSummary[] verbs = await client.VerbsAsync();
            foreach (VerbSummary row in verbs)
            {
                VerbInfo verb = await client.DescribeAsync(row.Name);
                var evaluator = new VerbEvaluator(await client.DownloadArtifactAsync(row.Name));
                double most = 0.0;
                for (int k = 0; k <= least / verbs.Length; k++, poses++)
                    most = Math.Max(most, await Miss(client, verb, evaluator, random, k));
                worst[row.Name] = most;
            }
        }
        return new Dictionary<string, object> { { "poses", poses }, { "worst", worst } };
    }

    static async Task<double> Miss(AdverbClient client, VerbInfo verb, VerbEvaluator evaluator, Random random, int k)
    {
        var adverbs = new Dictionary<string, double>();
        foreach (AdverbInfo each in verb.Adverbs)
            adverbs[each.Name] = each.Min + (1.4 * random.NextDouble() - 0.2) * (each.Max - each.Min);
        double at = random.NextDouble() * (verb.Looping && k % 4 == 0 ? 3.0 : 1.0);
        bool byTime = k % 3 == 0;
        var options = new PoseOptions { Method = k % 2 == 0 ? "rbf" : "refined", Plant = false };
        if (byTime) options.Time = at;
        else options.Phase = at;
        WireRecord theirs = await client.PoseAsync(verb.Name, adverbs, options);
        var ours = new EvaluatedPose();
        evaluator.Pose(evaluator.Ordered(adverbs), byTime ? double.NaN : at, ours, options.Method, at);
        if (ours.Clamped != theirs.Clamped || Math.Abs(ours.Phase - theirs.Phase) > 1e-5)
            return double.PositiveInfinity;
        var a = new float[3 * verb.Skeleton.Names.Length];
        var b = new float[a.Length];
        verb.Skeleton.Solve(theirs.Values, a);
        evaluator.Skeleton.Solve(ours.Values, b);
        double most = 0.0;
        for (int j = 0; j < a.Length; j += 3)
            most = Math.Max(most, Math.Sqrt(Sq(a[j] - b[j]) + Sq(a[j + 1] - b[j + 1]) + Sq(a[j + 2] - b[j + 2])));
        return most;
    }

    static double Sq(double value)
    {
        return value * value;
    }

    /// <summary>Microseconds of weights and pose, of a pose of weights and of joint positions, for verb files of a
    /// folder.</summary>
    internal static object Bench(string folder, string names)
    {
        var found = new Dictionary<string, object>();
        foreach (string name in names.Split(','))
        {
            VerbEvaluator evaluator = VerbEvaluator.Load(Path.Combine(folder, name + ".verb"));
            double[] middle = evaluator.Middle();
            var pose = new EvaluatedPose();
            evaluator.Pose(middle, 0.3, pose);
            var weights = (double[])pose.Weights.Clone();
            var positions = new float[3 * evaluator.Skeleton.Names.Length];
            var of = new EvaluatedPose { Weights = weights };
            found[name] = new Dictionary<string, object>
            {
                { "adverbs_us", Fastest(k => evaluator.Pose(middle, k, pose)) },
                { "weights_us", Fastest(k => evaluator.PoseOf(weights, k, of)) },
                { "positions_us", Fastest(k => evaluator.Skeleton.Solve(pose.Values, positions)) },
            };
        }
        return found;
    }

    static double Fastest(Action<double> what)
    {
        double best = double.PositiveInfinity;
        for (int round = 0; round < 20; round++)
        {
            Stopwatch watch = Stopwatch.StartNew();
            for (int k = 0; k < 200; k++) what(k / 200.0);
            best = Math.Min(best, watch.Elapsed.TotalMilliseconds * 1000.0 / 200.0);
        }
        return best;
    }
}
