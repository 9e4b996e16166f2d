// A stream that prints its events and poses as lines of JSON, and takes commands as lines of JSON on standard input.

using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading;
using System.Threading.Tasks;
using Adverb;

sealed class Driver
{
    const int EveryMs = 16;
    readonly Dictionary<string, object> _given;
    readonly AdverbPose _pose = new AdverbPose();
    AdverbStream _stream;
    AdverbChannel _channel, _closed;
    float[] _positions = new float[0];
    volatile bool _closing;

    internal Driver(Dictionary<string, object> given)
    {
        _given = given;
    }

    internal async Task<int> Run()
    {
        _stream = new AdverbStream((string)_given["server"], (string)_given.OrNull("key"));
        _stream.FirstDelayS = 0.02;
        _stream.MaxDelayS = 0.2;
        if (_given.ContainsKey("silence")) _stream.SilenceS = _given["silence"].Num();
        _stream.KeyAsSubprotocol = _given.ContainsKey("subprotocol");
        bool stays = _given.ContainsKey("stays");
        try
        {
            await _stream.ConnectAsync(_given.ContainsKey("timeout") ? _given["timeout"].Num() : 10.0);
            await Open();
        }
        catch (AdverbException error)
        {
            Failed(error);
            if (!stays) return 1;
            _stream.SetKey((string)Json.ParseObject(Console.In.ReadLine())["key"]);
            await Open();
        }
        new Thread(Listen) { IsBackground = true }.Start();
        while (!_closing && (stays || _stream.Ended == null))
        {
            PrintEvents();
            PrintPose();
            await Task.Delay(EveryMs);
        }
        await _stream.CloseAsync();
        PrintEvents();
        return 0;
    }

    async Task Open()
    {
        _channel = await _stream.OpenAsync((string)_given["verb"], OptionsOf(_given.OrNull("options")));
    }

    void Listen()
    {
        string line;
        while ((line = Console.In.ReadLine()) != null)
            try
            {
                Apply(Json.ParseObject(line)).GetAwaiter().GetResult();
            }
            catch (AdverbException error)
            {
                Failed(error);
            }
    }

    async Task Apply(Dictionary<string, object> command)
    {
        switch ((string)command["command"])
        {
            case "set": _channel.Set(OptionsOf(command["options"])); break;
            case "aim": _channel.Aim(command["adverbs"].Singles()); break;
            case "aim many": _stream.AimMany(new[] { _channel }, command["adverbs"].Singles()); break;
            case "view": _stream.View(command["position"].Nums(), command["budget"].Num()); break;
            case "switch": await _stream.SwitchAsync(_channel, (string)command["verb"]); break;
            case "open": await _stream.OpenAsync((string)command["verb"]); break;
            case "replace": await Replace(); break;
            case "closed aim": _closed.Aim(command["adverbs"].Singles()); break;
            case "closed aim many": _stream.AimMany(new[] { _closed }, command["adverbs"].Singles()); break;
            case "closed set": _closed.Set(OptionsOf(command["options"])); break;
            case "closed switch": await _stream.SwitchAsync(_closed, (string)command["verb"]); break;
            case "closed close": _stream.Close(_closed); break;
            case "key": _stream.SetKey((string)command["key"]); break;
            case "stats": PrintStats(); break;
            case "close": _closing = true; break;
        }
    }

    /// <summary>Closes the channel and opens another with the same options, and so the same number.</summary>
    async Task Replace()
    {
        _closed = _channel;
        _stream.Close(_closed);
        await Open();
        Program.Print(new Dictionary<string, object> { { "event", "replaced" }, { "number", _channel.Number } });
    }

    static OpenOptions OptionsOf(object given)
    {
        var found = new OpenOptions();
        if (given == null) return found;
        foreach (KeyValuePair<string, object> each in given.Map())
        {
            System.Reflection.FieldInfo field = typeof(OpenOptions).GetField(each.Key);
            object value = each.Value;
            if (each.Key == "Adverbs") value = each.Value.Map().ToDictionary(one => one.Key, one => one.Value.Num());
            else if (each.Key == "Joints") value = each.Value.List().ConvertAll(one => (string)one).ToArray();
            else if (field.FieldType == typeof(double?)) value = each.Value.Num();
            else if (field.FieldType == typeof(int?)) value = (int)each.Value.Num();
            field.SetValue(found, value);
        }
        return found;
    }

    void PrintEvents()
    {
        StreamEvent found;
        while (_stream.TryTakeEvent(out found))
        {
            var row = new Dictionary<string, object>
            {
                { "event", found.Kind.ToString().ToLowerInvariant() }, { "channel", found.Channel },
                { "name", found.Name },
                { "phase", found.Phase }, { "version", found.Version }, { "detail", found.Detail },
                { "close_code", found.CloseCode }, { "resumed", found.Resumed }, { "fields", found.Fields },
            };
            if (found.Error != null) row["error"] = RestRuns.Error(found.Error);
            if (found.Error != null) row["code"] = found.Error.Code;
            Program.Print(row);
        }
    }

    void PrintPose()
    {
        ChannelInfo info = _channel.Info;
        if (!_channel.Sample(_pose)) return;
        var row = new Dictionary<string, object>
        {
            { "event", "pose" }, { "number", _stream.Stats.Messages }, { "verb", info.Verb },
            { "version", _pose.Version },
            { "phase", _pose.Phase }, { "time", _pose.TimeS }, { "ended", _pose.Ended }, { "held", _pose.Held },
            { "delay_s", _pose.DelayS }, { "error", Fields.Finite(_pose.Error) },
            { "support", Fields.Finite(_pose.Support) },
            { "values", _pose.Values },
        };
        if (!_pose.IsWeights && info.Joints.Length == info.Skeleton.Names.Length && info.Space == "local")
        {
            Array.Resize(ref _positions, 3 * info.Joints.Length);
            info.Skeleton.Solve(_pose.Values, _positions);
            row["positions"] = _positions;
        }
        Program.Print(row);
    }

    void PrintStats()
    {
        StreamStats stats = _stream.Stats;
        Program.Print(new Dictionary<string, object>
        {
            { "event", "stats" }, { "live", _stream.Live }, { "reconnects", stats.Reconnects },
            { "resumes", stats.Resumes },
            { "decode_errors", stats.DecodeErrors }, { "last_error", stats.LastError }, { "gaps", stats.Gaps },
            { "records", stats.Records }, { "dropped", stats.Dropped },
            { "round_trip", Fields.Finite(_stream.Clock.RoundTripS) },
        });
    }

    static void Failed(AdverbException error)
    {
        Dictionary<string, object> row = RestRuns.Error(error);
        row["event"] = "failed";
        Program.Print(row);
    }
}
